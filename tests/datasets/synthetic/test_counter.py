"""The filmed scene `counter`: its content, and the poses, depths and videos on disk."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from datasets.files.errors import SceneError
from datasets.synthetic import build_scene, make_scene
from datasets.synthetic.__main__ import main
from datasets.synthetic.film import depth_of, film
from datasets.synthetic.rig import HALF_HEIGHT, HALF_WIDTH, RADIUS, grid, rig
from datasets.synthetic.scenes.counter import FAR
from datasets.synthetic.trace import trace
from datasets.synthetic.video import FRAME_RATE
from datasets.synthetic.world import World
from datasets.synthetic.write_film import BACKDROP, FilmSettings
from fuzz.target import read_files
from rasterizer.camera import Camera

SMALL = {"scene": "counter", "size": 64, "cameras": 3, "frames": 4, "samples": 1}
RIG = FilmSettings(seed=0, scene="counter", size=96, cameras=12, frames=4, samples=3)


@pytest.fixture(scope="module")
def set_up() -> tuple[World, list[Camera]]:
    return RIG.set_up()


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_scene(tmp_path_factory.mktemp("made") / "counter", seed=0, **SMALL)


@pytest.mark.parametrize("count", range(3, 25))
def test_first_camera_is_in_the_middle_of_the_grid(count: int) -> None:
    places = grid(count)
    assert places.shape == (count, 2) and len(np.unique(places, axis=0)) == count
    assert places[0].tolist() == [0, 0] and np.abs(places).max(axis=0).tolist() <= [HALF_WIDTH, HALF_HEIGHT]
    assert places[:, 0].min() == -HALF_WIDTH and places[:, 0].max() == HALF_WIDTH
    if count >= 8:  # rows above and below
        assert places[:, 1].min() == -HALF_HEIGHT and places[:, 1].max() == HALF_HEIGHT


def test_all_cameras_look_at_the_origin() -> None:
    cameras = rig(20, 64, 48, np.random.default_rng(0))
    assert len({(camera.width, camera.height, camera.fx, camera.fy) for camera in cameras}) == 1
    for camera in cameras:
        np.testing.assert_allclose((camera.world_to_cam @ [0, 0, 0, 1])[:3], [0, 0, RADIUS], atol=1e-9)
        assert (camera.world_to_cam[:3, :3] @ [0, 0, 1])[1] < -0.9  # upright: y points down


def test_scene_has_motion_and_flicker(set_up: tuple[World, list[Camera]]) -> None:
    world, cameras = set_up
    times = np.arange(60) / FRAME_RATE
    moving = [body for body in world.bodies if np.ptp([body.motion(t).position for t in times], axis=0).max() > 0.3]
    glowing = [body for body in world.bodies if body.material.glow is not None]
    assert len(moving) >= 3 and len(glowing) >= 3
    assert all(body.changes and not body.casts_shadow for body in moving + glowing)
    fast = np.fft.rfftfreq(300, 1 / FRAME_RATE) > 10
    for body in glowing:
        power = np.abs(np.fft.rfft([body.material.glow(i / FRAME_RATE).sum() for i in range(300)]))[1:] ** 2
        assert power[fast[1:]].sum() > 0.1 * power.sum()
    depths = [depth_of(world, cameras[0], time) for time in times[::6]]
    assert 0.03 < (np.ptp(depths, axis=0) > 0).mean() < 0.4  # share of pixels whose depth changes


@pytest.mark.parametrize("seed", [0, 1])
def test_distant_landscape_has_no_parallax(seed: int) -> None:
    world, cameras = replace(RIG, size=320, seed=seed).set_up()
    middle = cameras[0]
    for camera in cameras:
        depth = depth_of(world, camera.resized(96, 72), 0.0)
        assert 0.10 <= (depth > BACKDROP).mean() <= 0.25 and depth[depth < BACKDROP].max() < 8
    # Parallax: projection of a landscape point, minus its projection with the same rotation from the middle camera.
    point = middle.position + FAR * middle.world_to_cam[2, :3]
    for camera in cameras:
        shifted, reference = (camera.world_to_cam[:3, :3] @ (point - eye) for eye in (camera.position, middle.position))
        assert np.linalg.norm(camera.fx * (shifted[:2] / shifted[2] - reference[:2] / reference[2])) < 1.0  # pixels


def test_static_surfaces_have_sift_features() -> None:
    world, cameras = replace(RIG, size=320).set_up()
    camera = cameras[0]
    grey = cv2.cvtColor(next(film(world, camera, [0.0], samples=1)), cv2.COLOR_RGB2GRAY)
    still = replace(world, bodies=tuple(body for body in world.bodies if not body.changes))
    depth = depth_of(world, camera, 0.0)
    is_static = (depth == depth_of(still, camera, 0.0)) & (depth < BACKDROP)
    places = np.array([point.pt for point in cv2.SIFT_create().detect(grey)]).round().astype(int)
    assert is_static[places[:, 1], places[:, 0]].sum() > 500


def test_bytes_depend_on_the_seed_and_not_on_processes(scene: Path, tmp_path: Path) -> None:
    done = []
    again = build_scene(tmp_path / "again", seed=0, processes=2, progress=lambda *both: done.append(both), **SMALL)
    other = build_scene(tmp_path / "other", seed=1, **SMALL)
    assert read_files(again) == read_files(scene) and done == [(1, 3), (2, 3), (3, 3)]
    assert all(content != read_files(scene)[name] for name, content in read_files(other).items())
    assert sorted(read_files(scene)) == [
        "cam00.mp4",
        "cam01.mp4",
        "cam02.mp4",
        "croissant.json",
        "manifest.yaml",
        "meta.json",
        "poses_bounds.npy",
        *(name for n in range(3) for name in (f"truth/cam0{n}.npz", f"truth/cam0{n}_depth.npy")),
    ]


def test_depth_and_bounds_of_the_first_frame(scene: Path) -> None:
    world, cameras = FilmSettings(seed=0, **SMALL).set_up()
    poses = np.load(scene / "poses_bounds.npy")
    assert poses.shape == (3, 17) and poses.dtype == np.float64
    for number, (camera, row) in enumerate(zip(cameras, poses)):
        depth = np.load(scene / "truth" / f"cam{number:02d}_depth.npy")
        assert depth.shape == (48, 64) and depth.dtype == np.float32 and np.isfinite(depth).all()
        # Two float32 computations (6e-8); the error is larger at grazing angles.
        np.testing.assert_allclose(depth, trace(world, camera, 0.0, samples=1).depth, rtol=1e-5)
        kitchen = depth[depth < BACKDROP]
        assert row[15] == kitchen.min() and row[16] == kitchen.max()


def test_poses_and_depths_are_consistent_between_cameras(scene: Path) -> None:
    """From the file alone, by LLFF's convention: columns down, right, backward, centre, (height, width, focal)."""
    rows = np.load(scene / "poses_bounds.npy")[:, :15].reshape(3, 3, 5)
    depths = [np.load(scene / "truth" / f"cam{number:02d}_depth.npy") for number in range(3)]
    j, i = np.mgrid[:48, :64]
    for source, target in ((0, 1), (0, 2), (2, 1)):
        down, right, backward, centre, (height, width, focal) = rows[source].T
        assert (height, width) == (48, 64)
        ray = ((i + 0.5 - width / 2) / focal)[..., None] * right + ((j + 0.5 - height / 2) / focal)[..., None] * down
        points = centre + depths[source][..., None] * (ray - backward)
        down, right, backward, centre, _ = rows[target].T
        z = -(points - centre) @ backward
        x = focal * ((points - centre) @ right) / z + width / 2
        y = focal * ((points - centre) @ down) / z + height / 2
        inside = (x > 0) & (x < width) & (y > 0) & (y < height)
        expected = depths[target][y[inside].astype(int), x[inside].astype(int)]
        # The rest is occluded in the target, or within half a pixel of an edge.
        assert inside.mean() > 0.6 and (np.abs(expected / z[inside] - 1) < 0.03).mean() > 0.8
        np.testing.assert_allclose(focal, 0.85 * 64)


def test_an_exception_leaves_no_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("datasets.synthetic.write_film.write_video", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        build_scene(tmp_path / "counter", seed=0, **SMALL)
    assert list(tmp_path.iterdir()) == []


def test_cache_folder_depends_on_the_scenes_arguments(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[dict] = []
    monkeypatch.setattr("datasets.synthetic.build_scene", lambda folder, **options: made.append(options))

    def names(scene: str, *changes: dict) -> int:
        return len({make_scene(scene, tmp_path, **change) for change in ({}, *changes)})

    assert names("counter", {"cameras": 4}, {"frames": 5}, {"size": 64}, {"seed": 1}) == 5
    assert names("counter", {"train_views": 4}, {"test_views": 5}) == 1
    assert names("wheel", {"cameras": 4}, {"frames": 5}) == 1
    assert made[0] == {"scene": "counter", "seed": 0, "size": 200, "cameras": 12, "frames": 60, "progress": None}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"size": 63}, "scene.size: expected an even number, at least 16, found 63"),
        ({"size": 8}, "scene.size: expected an even number, at least 16, found 8"),
        ({"cameras": 2}, "scene.cameras: expected at least 3, found 2"),
        ({"frames": 0}, "scene.frames: expected at least 1, found 0"),
        ({"samples": 2}, "samples: expected an odd number of rays along a pixel's side, found 2"),
        ({"processes": 0}, "processes: expected at least 1, found 0"),
    ],
)
def test_invalid_arguments_are_refused_in_one_line(changes: dict, message: str, tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=f"^{re.escape(message)}$"):
        build_scene(tmp_path / "counter", seed=0, **{**SMALL, **changes})
    assert list(tmp_path.iterdir()) == []


def test_height_is_three_quarters_and_even() -> None:
    assert [replace(RIG, size=size).height for size in (320, 1352, 200, 100, 64)] == [240, 1014, 150, 76, 48]


def test_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sizes = "--size 32 --cameras 3 --frames 2 --samples 1 --processes 1"
    options = ["counter", "--out", str(tmp_path / "out"), *sizes.split()]
    assert main(options) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[:3] == ["1/3 cameras", "2/3 cameras", "3/3 cameras"]
    assert "3 cameras, 2 frames each, 32 pixels wide" in lines[3] and len(lines) == 4
    assert cv2.VideoCapture(str(tmp_path / "out" / "cam02.mp4")).get(cv2.CAP_PROP_FRAME_COUNT) == 2
