"""python -m datasets.synthetic street: the folder is a driving log, and the command says so."""

from __future__ import annotations

from pathlib import Path

import pytest

from datasets.readers.waymo import open_waymo
from datasets.synthetic.__main__ import main


def test_a_driving_log_is_written_and_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "street"
    assert main(["street", "--out", str(folder), "--size", "32", "--frames", "3"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[:-1] == ["1/3 frames", "2/3 frames", "3/3 frames"]
    assert f"{folder}: a driving log of 3 frames, with LiDAR, images 32 pixels wide, in " in lines[-1]
    log = open_waymo(folder)
    assert log.frames == len(log.sweeps) == 3 and {image.camera.width for image in log.images} == {32}
