"""The whole chain on a scene that several cameras filmed: videos to metrics, killed at any stage, and without poses."""

from __future__ import annotations

import json
import shutil
import time
from pathlib import Path

import cv2
import numpy as np
import pytest
from shell import Shell, result

from datasets.files.claim import HIDDEN

TINY = (
    "train=smoke",
    "scene.downscale=1",
    "threads=1",
    "evaluate.lpips=false",
    "evaluate.renders=2",
    "init.min_points=20",
    "init.max_features=1000",
    "init.sphere_points=2000",
)
COUNTER = ("scene=synthetic/counter", "scene.size=160", "scene.cameras=5", "scene.frames=4", *TINY)


@pytest.fixture(scope="module")
def shell(tmp_path_factory) -> Shell:
    return Shell(tmp_path_factory.mktemp("filmed"))


@pytest.fixture(scope="module")
def finished(shell: Shell) -> Path:
    """The folder of a run that ended well."""
    out, err = shell(*COUNTER)
    assert err == "" and "sfm: " in out
    return shell.folder / "results/runs/synthetic/counter/full/smoke/seed0"


def test_a_run_leaves_points_pictures_and_videos(finished: Path) -> None:
    summary = json.loads((finished / "sfm.json").read_text())
    assert summary["registered"] == summary["cameras"] == 4 and summary["poses"] == "known"  # one of five is held out
    assert summary["points"] >= 20 and summary["mean_error_px"] < 1.0 and summary["mean_track_length"] >= 3
    assert (finished / "sfm.png").stat().st_size > 5000
    metrics = json.loads((finished / "metrics.json").read_text())
    assert metrics["n_test_views"] == 4 and metrics["final"]["flicker"] > 0
    film = cv2.VideoCapture(str(finished / "renders" / "cam00_render_and_truth.mp4"))
    assert film.get(cv2.CAP_PROP_FRAME_COUNT) == 4 and film.get(cv2.CAP_PROP_FPS) == 30
    assert (finished / "renders" / "bullet_time.mp4").stat().st_size > 1000


def test_doing_it_again_does_nothing(finished: Path, shell: Shell) -> None:
    kept = [
        path
        for path in (shell.folder / "results").rglob("*")
        if path.is_file() and path.name != "config.yaml" and not path.name.startswith(HIDDEN)
    ]
    before = {path: path.stat().st_mtime_ns for path in kept}
    out, _ = shell(*COUNTER)
    assert all(f"{stage}: already done" in out for stage in ("prepare", "settle", "init", "train", "evaluate"))
    assert {path: path.stat().st_mtime_ns for path in kept} == before


def test_killed_again_and_again_it_ends_the_same(finished: Path, shell: Shell) -> None:
    """Killed while making the videos, in structure from motion, decoding, in training and in the evaluation."""
    again = Shell(shell.folder / "killed")
    again.folder.mkdir()
    for moment in ("2 of 5 cameras rendered", "sfm: 4 images", "decoded cam01", "iteration 20:", "evaluate:"):
        command = again.start(*COUNTER)
        while moment not in command.said():
            assert command.is_running(), (moment, command.wait())
            time.sleep(0.01)
        command.kill()
    again(*COUNTER)
    assert result(again.folder / "results/runs/synthetic/counter/full/smoke/seed0") == result(finished)


def test_videos_without_poses(finished: Path, shell: Shell) -> None:
    """The same videos under other names, and no poses: the cameras are found, the held-out one too."""
    videos = shell.folder / "videos"
    videos.mkdir()
    for path in sorted((shell.folder / "results" / "cache").glob("counter-*/cam*.mp4")):
        shutil.copy(path, videos / f"left{path.name}")
    out, _ = shell("scene=video", f"scene.path={videos}", *TINY, "init.max_features=2000")
    folder = shell.folder / "results/runs/video/videos/full/smoke/seed0"
    assert json.loads((folder / "sfm.json").read_text())["poses"] == "estimated"
    assert json.loads((folder / "metrics.json").read_text())["n_test_views"] == 4


def test_the_environment_map_is_trained_and_shown(finished: Path, shell: Shell) -> None:
    shell(*COUNTER, "scene.background_model=envmap", "out=envmap")
    with_map, with_sphere = (
        json.loads((folder / "metrics.json").read_text()) for folder in (shell.folder / "envmap", finished)
    )
    assert with_map["final"]["psnr"] != with_sphere["final"]["psnr"]
    assert with_map["n_gaussians"] < with_sphere["n_gaussians"]


def test_what_it_would_take_is_said_without_doing_it(finished: Path, shell: Shell) -> None:
    before = sorted((shell.folder / "results").rglob("*"))
    out, _ = shell(*COUNTER, "seed=7", "estimate=true")
    assert sorted((shell.folder / "results").rglob("*")) == before
    assert "would take" in out and "disk: " in out and "memory: " in out and "time: " in out
    # Frames are 160 x 120 pixels of 3 bytes, 5 cameras of 4: 1.2 MB.
    assert "0.0 GB of frames and flow" in out


def test_a_fault_in_the_data_ends_in_one_line(finished: Path, shell: Shell) -> None:
    broken = shell.folder / "broken"
    shutil.copytree(next((shell.folder / "results" / "cache").glob("counter-*")), broken)
    poses = np.load(broken / "poses_bounds.npy")
    np.save(broken / "poses_bounds.npy", poses[:-1])
    _, err = shell("scene=plenoptic", f"scene.path={broken}", *TINY, status=1)
    assert err.count("\n") == 1 and "poses_bounds.npy" in err and "5" in err and "4" in err
