"""A run's stages: which are done, skipped or done again, by configuration, data and code."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from tiny import tiny_scene

import pipeline.stages.run as run_module
from pipeline.config.compose import Command
from pipeline.config.schema import Config
from pipeline.data.prepare import Prepared
from pipeline.runs.run_folder import RunFolder
from pipeline.stages.run import chosen_stages, run
from pipeline.stages.stages import Job, prepare_points

TINY = (
    "scene=synthetic/wheel", "scene.size=32", "scene.train_views=6", "scene.test_views=2", "train=smoke",
    "train.iterations=12", "train.init_points=200", "evaluate.lpips=false", "evaluate.videos=false", "threads=1",
)  # fmt: skip


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(scope="module")
def finished(cache: Path) -> Path:
    run(Command((*TINY, f"scene.cache={cache}", f"out={cache / 'run'}")), lambda line: None)
    return cache / "run"


def again(folder: Path, *overrides: str) -> tuple[dict | None, dict[str, str]]:
    """What the run returns, and of each stage what its line says."""
    lines: list[str] = []
    found = run(Command((*TINY, f"scene.cache={folder.parent}", f"out={folder}", *overrides)), lines.append)
    said = dict(line.partition(": ")[::2] for line in lines if ": " in line)
    return found, {
        name: said[name] for name in said if name in ("prepare", "settle", "init", "train", "evaluate", "page")
    }


def records(folder: Path) -> dict:
    return json.loads((folder / "stages.json").read_text())


def test_a_finished_run_is_done_and_says_what_it_is(finished: Path) -> None:
    before = (finished / "checkpoint.safetensors").stat().st_mtime_ns
    metrics, said = again(finished)
    assert all(line.startswith("already done") for line in said.values()) and len(said) == 6
    assert (finished / "checkpoint.safetensors").stat().st_mtime_ns == before
    assert metrics is not None
    declared = {key: metrics[key] for key in ("scene", "recipe", "model", "seed", "decided")}
    assert declared == {"scene": "synthetic/wheel", "recipe": "smoke", "model": "full", "seed": 0, "decided": {}}
    assert metrics["changes"]["train.iterations"] == 12 and "threads" not in metrics["changes"]
    assert metrics["kind"] == {"motion": "full", "fourier_order": 2, "sh_degree": 3, "trajectories": 0}


def test_parts_of_a_run_make_the_whole(finished: Path) -> None:
    folder = finished.parent / "parts"
    assert again(folder, "until=init")[0] is None and list(records(folder)) == ["prepare", "settle", "init"]
    with pytest.raises(ValueError, match=r"train: not done in .*parts; until=train does it"):
        again(folder, "only=evaluate")
    assert again(folder, "only=[train,evaluate]")[1].keys() == {"train", "evaluate"}
    assert (folder / "checkpoint.safetensors").read_bytes()[-1000:] == (
        finished / "checkpoint.safetensors"
    ).read_bytes()[-1000:]  # tensors; the header has seconds


def test_other_code_makes_its_stages_again_and_says_so(finished: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = finished.parent / "code"
    again(folder)
    code_hash = run_module.code_hash
    monkeypatch.setattr(
        run_module, "code_hash", lambda rooms: code_hash(rooms) + "x" * ("pipeline/evaluation" in rooms)
    )
    _, said = again(folder, "only=page")
    assert said["evaluate"].startswith("kept, though other code made it (commit")
    lines: list[str] = []
    run(Command((*TINY, f"scene.cache={folder.parent}", f"out={folder}")), lines.append)
    assert any(line.startswith("evaluate: other code made it (commit") for line in lines)
    assert any(line.startswith("train: already done") for line in lines), "its code is the same"


def test_training_that_other_code_began_is_not_continued(tmp_path: Path) -> None:
    inputs = {"data": "d", "config": "c", "code": "1"}
    with RunFolder(tmp_path / "run") as folder:
        assert not folder.begin("train", inputs, ("checkpoint.safetensors",))
        folder.checkpoint.write_text("half of it")
        assert not folder.begin("train", inputs, ("checkpoint.safetensors",)) and folder.checkpoint.exists()
        assert folder.begin("train", {**inputs, "code": "2"}, ("checkpoint.safetensors",))
        assert not folder.checkpoint.exists()


def test_other_data_are_refused(finished: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run_module, "data_hash", lambda data: "other")
    with pytest.raises(ValueError, match=r"run: holds a run made from other data than .*; give another out=DIR"):
        again(finished)


@pytest.mark.parametrize(
    "keys, error",
    [
        ({"until": "training"}, "until: expected prepare, settle, init, train, evaluate, page, found 'training'"),
        ({"only": ["train", "sfm"]}, "only: expected prepare, settle, init, train, evaluate, page, found 'sfm'"),
        ({"only": "train", "until": "init"}, "until: expected nothing beside only=[train], found 'init'"),
        (
            {"only": ["evaluate"], "resume": False},  # which would delete the checkpoint
            "resume: expected true beside only=[evaluate], which keeps earlier stages, found false",
        ),
    ],
)
def test_stages_that_do_not_exist_are_refused(keys: dict, error: str) -> None:
    with pytest.raises(ValueError) as refused:
        chosen_stages(replace(Config(), **keys))
    assert str(refused.value) == error


def test_cameras_without_points_have_files_too(tmp_path: Path) -> None:
    """`init.source=random` on a video: poses come from structure from motion, points do not."""
    (tmp_path / "cache").mkdir()
    for name in ("sfm.json", "sfm.png"):
        (tmp_path / "cache" / name).write_text(name)
    data = Prepared(tiny_scene(), None, tmp_path / "cache")
    with RunFolder(tmp_path / "run") as folder:
        assert prepare_points(Job(Command(()), Config(), data, folder, print)) == {}
        assert folder.sfm.read_text() == "sfm.json" and folder.sfm_picture.read_text() == "sfm.png"
