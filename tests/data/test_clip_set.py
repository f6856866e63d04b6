"""Several cameras of which some move: films of the kitchen counter along two paths and from a tripod."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from clips import write_clip

from datasets.clip import stands_still
from datasets.settings import SceneConfig
from datasets.synthetic.rig import rig
from datasets.synthetic.scenes import counter
from datasets.synthetic.trace import trace
from pipeline.config.schema import Config, InitConfig
from pipeline.data.prepare import Prepared, prepare
from pipeline.evaluation.pictures.camera_path import look_at
from rasterizer.camera import Camera

SIZE = (216, 162)
COUNT = 16  # frames of each film
RATES = {"left": 20.0, "right": 24.0, "tripod": 25.0}
STARTS = {"left": 0.0, "right": 0.15, "tripod": 0.05}  # seconds
ARCS = {"left": (-0.35, 0.05), "right": (0.4, 0.05), "tripod": (0.0, 0.0)}  # radians around the counter


def true_camera(name: str, frame: int) -> Camera:
    first, last = ARCS[name]
    angle = first + (last - first) * frame / (COUNT - 1)
    height = {"left": 0.6, "right": 0.75, "tripod": 0.5}[name]
    position = np.array([3.2 * np.sin(angle), -3.2 * np.cos(angle), height + 0.3 * angle])
    focal = rig(3, *SIZE, np.random.default_rng(0))[0].fx * (1.1 if name == "right" else 1.0)
    pose = look_at(position, np.array([0.0, 0.3, 0.0]), np.array([0.0, 0.0, -1.0]))
    return Camera(*SIZE, focal, focal, SIZE[0] / 2, SIZE[1] / 2, pose)


def true_time(name: str, frame: int) -> float:
    return STARTS[name] + frame / RATES[name]


@pytest.fixture(scope="module")
def videos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("set") / "videos"
    folder.mkdir()
    world = counter.build(np.random.default_rng(0))
    for name, rate in RATES.items():
        images = [
            np.rint(255 * trace(world, true_camera(name, i), true_time(name, i), samples=1).color.transpose(1, 2, 0))
            for i in range(COUNT)
        ]
        write_clip(folder / f"{name}.mp4", [image.astype(np.uint8) for image in images], np.arange(COUNT) / rate)
    return folder


def prepared(videos: Path, **scene: object) -> tuple[Prepared, list[str]]:
    lines: list[str] = []
    settings = {"sync": "given", "offsets": list(STARTS.values()), "moving_cameras": "auto", "downscale": 1, **scene}
    cache = str(videos.parent / "cache")
    cfg = SceneConfig("video", "video", str(videos), cache=cache, **settings)
    return prepare(Config(scene=cfg, init=InitConfig(min_points=50), threads=1), lines.append), lines


def test_cameras_that_move_are_told_from_those_that_stand_still(videos: Path) -> None:
    assert {path.stem: stands_still(path) for path in videos.iterdir()} == {
        "left": False,
        "right": False,
        "tripod": True,
    }


def test_poses_and_times(videos: Path) -> None:
    data, lines = prepared(videos)
    assert any("cameras that move: left, right; that stand still: tripod" in line for line in lines)
    views = data.scene.train + data.scene.test
    assert len(views) >= 0.95 * len(RATES) * COUNT
    truth = [(*view.name.split("/")[1].rsplit("_", 1),) for view in views]
    true_times = np.array([true_time(name, int(number)) for name, number in truth])
    seconds = np.array([view.time for view in views]) / data.canonical.time_scale
    np.testing.assert_allclose(seconds, true_times - true_times.min(), atol=1e-4)  # ticks of the files
    check_poses([view.camera for view in views], [true_camera(name, int(number)) for name, number in truth])


def check_poses(found: list[Camera], truth: list[Camera]) -> None:
    """Within 3 % of the farthest distance between cameras and 2 degrees, after a similarity."""
    turns, true_turns = (np.stack([c.world_to_cam[:3, :3] for c in cameras]) for cameras in (found, truth))
    u, _, vt = np.linalg.svd(np.einsum("nij,nik->jk", true_turns, turns))
    rotation = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    positions, expected = (np.stack([c.position for c in cameras]) for cameras in (found, truth))
    a, b = (positions - positions.mean(axis=0)) @ rotation.T, expected - expected.mean(axis=0)
    scale = (a * b).sum() / (a**2).sum()
    span = np.linalg.norm(np.ptp(expected, axis=0))
    assert np.linalg.norm(scale * a - b, axis=1).max() < 0.03 * span
    cosines = (np.einsum("nij,kj,nik->n", turns, rotation, true_turns) - 1) / 2
    assert np.degrees(np.arccos(np.clip(cosines, -1, 1))).max() < 2
