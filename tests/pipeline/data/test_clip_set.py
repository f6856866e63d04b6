"""Several cameras of which some move: films of the kitchen counter along two paths and from a tripod."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from clips import textured_plane, write_clip

from datasets.cameras.color import ColorCorrection
from datasets.clip.survey import stands_still
from datasets.settings import SceneConfig
from datasets.source import Photograph
from datasets.synthetic.rig import rig
from datasets.synthetic.scenes import counter
from datasets.synthetic.trace import trace
from pipeline.config.schema import Config, InitConfig
from pipeline.data.prepare import Prepared, prepare
from pipeline.data.sfm.clip import by_lens, pairs_of, reconstruct_clip
from pipeline.evaluation.pictures.camera_path import look_at
from rasterizer.camera import Camera

SIZE = (216, 162)
COUNT = 13  # frames of each film
RATES = {"left": 16.0, "right": 19.0, "tripod": 20.0}
STARTS = {"left": 0.0, "right": 0.15, "tripod": 0.05}  # seconds
ARCS = {"left": (-0.35, 0.05), "right": (0.4, 0.05), "tripod": (0.0, 0.0)}  # radians around the counter

WORLD = counter.build(np.random.default_rng(0))
FILMED = ColorCorrection((0.7, 0.75, 0.85), (0, 2, 6))  # what the right camera makes of the colours


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


def trace_image(name: str, frame: int) -> np.ndarray:
    color = trace(WORLD, true_camera(name, frame), true_time(name, frame), samples=1).color
    return np.rint(255 * color.transpose(1, 2, 0)).astype(np.uint8)


@pytest.fixture(scope="module")
def videos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("set") / "videos"
    folder.mkdir()
    for name, rate in RATES.items():
        images = [trace_image(name, i) for i in range(COUNT)]
        if name == "right":
            images = [FILMED.apply(image) for image in images]
        write_clip(folder / f"{name}.mp4", images, [i / rate for i in range(COUNT)])
    return folder


def prepared(videos: Path, **scene: object) -> tuple[Prepared, list[str]]:
    lines: list[str] = []
    settings = {"sync": "given", "offsets": list(STARTS.values()), "moving_cameras": "auto", "downscale": 1, **scene}
    cache = str(videos.parent / "cache")
    cfg = SceneConfig("video", "video", str(videos), cache=cache, **settings)
    return prepare(Config(scene=cfg, init=InitConfig(min_points=50), threads=1), lines.append), lines


@pytest.fixture(scope="module")
def kept(videos: Path) -> tuple[Prepared, list[str]]:
    """The right camera's film is darker and bluer, and made lighter again."""
    return prepared(videos, color_correction="auto")


def test_cameras_that_move_are_told_from_those_that_stand_still(videos: Path, tmp_path: Path) -> None:
    assert {path.stem: stands_still(path, tmp_path) for path in videos.iterdir()} == {
        "left": False,
        "right": False,
        "tripod": True,
    }


def test_poses_and_times(videos: Path, kept: tuple[Prepared, list[str]]) -> None:
    data, lines = kept
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


def test_lenses_are_those_of_the_cameras(kept: tuple[Prepared, list[str]]) -> None:
    """One focal length a camera, within 4 %, and their ratio within 2 %."""
    focal: dict[str, set[float]] = {name: set() for name in RATES}
    for view in kept[0].scene.train + kept[0].scene.test:
        focal[view.name.split("/")[1].rsplit("_", 1)[0]].add(view.camera.fx)
    assert all(len(found) == 1 for found in focal.values())
    one = {name: found.pop() for name, found in focal.items()}
    for name, found in one.items():
        assert found == pytest.approx(true_camera(name, 0).fx, rel=0.04)
    assert one["right"] / one["left"] == pytest.approx(1.1, rel=0.02)


def test_colours_of_one_camera_are_corrected(kept: tuple[Prepared, list[str]]) -> None:
    """Every picture has the scene's colours, in the median within three levels of 255; the right film is 20 darker."""
    data, lines = kept
    assert any(line.startswith("colours are corrected") and "right" in line for line in lines)
    for view in data.scene.train + data.scene.test:
        name, number = view.name.split("/")[1].rsplit("_", 1)
        true = trace_image(name, int(number)).astype(float)
        assert np.abs(np.median(np.asarray(view.image) - true, axis=(0, 1))).max() < 3
        if name == "right":
            assert np.median(true - FILMED.apply(true.astype(np.uint8))) > 20


def test_a_camera_that_sees_something_else_is_named(videos: Path) -> None:
    photographs = [
        Photograph(f"00_{i:02d}", trace_image("left", i), lens="left", time=i / 20) for i in range(0, COUNT, 2)
    ]
    photographs += [
        Photograph(f"01_{i:02d}", textured_plane(3.0 * i, SIZE), lens="other", time=i / 20) for i in range(4)
    ]
    with pytest.raises(ValueError, match="^set: expected to find other among the other cameras, found 0 of 4 of its"):
        reconstruct_clip(photographs, InitConfig(min_points=30), Path("set"), lambda line: None)


def test_pairs_between_cameras_follow_their_times() -> None:
    one = [Photograph(f"a{i}", np.zeros((1, 1, 3), np.uint8), lens="a", time=0.1 * i) for i in range(40)]
    other = [Photograph(f"b{i}", np.zeros((1, 1, 3), np.uint8), lens="b", time=0.25 + 0.1 * i) for i in range(30)]
    assert [lens[0].name for lens in by_lens(one + other)] == ["a0", "b0"]
    pairs = pairs_of([one, other])
    assert len({tuple(pair) for pair in pairs}) == len(pairs)
    between = {(int(a[1:]), int(b[1:])) for a, b in pairs if a[0] != b[0]}
    assert all((i, i - 3) in between or (i, i - 2) in between for i in range(3, 30))
    assert {a for a, _ in between} == set(range(40)) and {b for _, b in between} == set(range(30))
