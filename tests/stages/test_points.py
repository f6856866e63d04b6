"""The stage that copies structure from motion's result into the run folder."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from tiny import tiny_config, tiny_scene

from pipeline.data.prepared import Prepared
from pipeline.runs.run_folder import RunFolder
from pipeline.stages.inputs import stage_inputs
from pipeline.stages.points import copy_points


def test_cameras_without_points_have_files_too(tmp_path: Path) -> None:
    """`init.source=random` on a video: poses come from structure from motion, points do not."""
    cache = tmp_path / "cache"
    cache.mkdir()
    for name in ("sfm.json", "sfm.png"):
        (cache / name).write_text(name)
    data, cfg = Prepared(tiny_scene(), None, cache), tiny_config()
    assert list(stage_inputs(cfg, data)) == ["sfm", "init", "train", "evaluate", "view"]
    with RunFolder(tmp_path / "run", asdict(cfg)) as folder:
        assert copy_points(cfg, data, folder, print) == {}
        assert folder.sfm.read_text() == "sfm.json" and folder.sfm_picture.read_text() == "sfm.png"
