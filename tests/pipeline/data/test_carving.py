"""Carving against closed forms: a ball that moves over a textured floor, seen by five cameras 72 degrees apart.

Cells are about 1.5 pixels, which is the tolerance of a hull's surface. A hull of five views is larger than the ball
between them: by r (1 / cos(a / 2) - 1) where the silhouettes' planes meet at an angle a, here 0.24 r at most.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import torch
from plenoptic_folder import write_video
from scipy.ndimage import gaussian_filter, map_coordinates

from datasets.scene import Scene, ScenePoints, View, camera_extent
from datasets.settings import SceneConfig
from datasets.synthetic.camera_path import look_at_origin
from pipeline.config.schema import Config, InitConfig
from pipeline.data.carving.carve import SHELL, CameraFilm, carve, moving_pixels, smoothed
from pipeline.data.carving.hull import hull
from pipeline.data.carving.start import carved_points, covered_share
from pipeline.data.carving.sweep import depths
from pipeline.data.prepare import Prepared, prepare
from pipeline.data.sfm.run import TooFewPoints
from pipeline.model.initialise import from_timed_points
from rasterizer.camera import Camera

WIDTH, HEIGHT, FOCAL = 80, 60, 90.0
RADIUS = 0.3
TIMES = 8
FLOOR = -0.35
BOX = ((-1.2, -1.2, -1.2), (1.2, 1.2, 1.2))


def rig() -> list[Camera]:
    places = [(4 * np.cos(a) * 0.8, 4 * np.sin(a) * 0.8, 4 * 0.6) for a in 2 * np.pi * np.arange(5) / 5]
    return [Camera.from_blender(WIDTH, HEIGHT, FOCAL, look_at_origin(np.array(place))) for place in places]


def rays(camera: Camera) -> np.ndarray:
    """(H, W, 3) in the world, of depth 1."""
    column, row = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    local = np.stack([(column - camera.cx) / camera.fx, (row - camera.cy) / camera.fy, np.ones_like(column)], axis=-1)
    return local @ camera.world_to_cam[:3, :3]


def ball(camera: Camera, centre: np.ndarray) -> np.ndarray:
    """(H, W) bool: where it is seen."""
    towards, ray = centre - camera.position, rays(camera)
    along = ray @ towards / np.linalg.norm(ray, axis=-1)
    return towards @ towards - along**2 < RADIUS**2


def to_floor(camera: Camera) -> np.ndarray:
    """(H, W) depth of the plane z = FLOOR; inf above the horizon."""
    down = rays(camera)[..., 2]
    return np.where(down < 0, (FLOOR - camera.position[2]) / np.where(down < 0, down, -1), np.inf)


@cache
def texture() -> np.ndarray:
    noise = gaussian_filter(np.random.default_rng(0).normal(size=(400, 400)), 2.0)
    return np.clip(120 + 50 * noise / noise.std(), 0, 255)


def floor_image(camera: Camera) -> np.ndarray:
    """(H, W, 3) uint8: the texture within 3 units, grey beyond."""
    depth = to_floor(camera)
    x, y = np.moveaxis((camera.position + depth[..., None] * rays(camera))[..., :2], -1, 0)
    near = np.hypot(x, y) < 3
    place = [np.where(near, (axis + 3) * 400 / 6, 0) for axis in (x, y)]
    grey = np.where(near, map_coordinates(texture(), place, order=1), 60)
    return np.repeat(grey[..., None], 3, axis=2).astype(np.uint8)


def path() -> np.ndarray:
    angle = np.linspace(0, 1.6 * np.pi, TIMES)
    return np.stack([0.7 * np.cos(angle), 0.7 * np.sin(angle), np.zeros(TIMES)], axis=1)


def films() -> list[CameraFilm]:
    found = []
    for camera in rig():
        images = np.repeat(floor_image(camera)[None], TIMES, axis=0)
        for image, centre in zip(images, path()):
            image[ball(camera, centre)] = (220, 120, 60)
        found.append(CameraFilm(camera, images))
    return found


def scene_of(films: list[CameraFilm]) -> Scene:
    views = [
        View(film.camera, float(time), image, f"train/cam{number}_{time:04d}", filmed_by=f"cam{number}")
        for number, film in enumerate(films)
        for time, image in enumerate(film.images)
    ]
    extent = camera_extent([film.camera for film in films])
    return Scene(
        "rig", tuple(views), (views[0],), float(TIMES), 0.0, (0, 0, 0), extent, (-1.2, 1.2), Path("rig"), "multi_view"
    )


def test_the_hull_of_a_ball_is_around_it() -> None:
    centre = np.array([0.3, -0.2, 0.1])
    points, cell = hull([ball(camera, centre) for camera in rig()], rig(), BOX)
    assert len(points) > 100 and cell * FOCAL / 3 < 3  # pixels
    away = np.linalg.norm(points - centre, axis=1) - RADIUS
    pixel = 4.5 / FOCAL
    assert away.min() > -(cell + pixel) and away.max() < 0.24 * RADIUS + 2 * (cell + pixel)


def test_silhouettes_that_contradict_each_other_have_no_hull() -> None:
    apart = [np.array([0.8, 0, 0]), np.array([-0.8, 0, 0])]
    silhouettes = [ball(camera, apart[number % 2]) for number, camera in enumerate(rig())]
    assert len(hull(silhouettes, rig(), BOX)[0]) == 0


def test_the_sweep_finds_the_floor() -> None:
    """3 % of the depth are the steps of the sweep and the bilinear texture."""
    grey = [floor_image(camera)[..., 0].astype(np.float32) for camera in rig()]
    found = depths(grey, rig(), [(1.2, 8.0)] * 5)
    for camera, depth in zip(rig(), found):
        known = depth > 0
        right = np.abs(depth - to_floor(camera))[known] < 0.03 * depth[known]
        assert known.mean() > 0.3 and right.mean() > 0.8


def test_wrong_depths_among_right_ones_are_replaced_and_gaps_filled() -> None:
    depth = np.full((30, 40), 4.0, np.float32)
    depth[10, 10], depth[12:15, 20:23], depth[:, 35:] = 2.0, 0.0, 0.0
    found = smoothed(depth)
    assert (found[5:25, 5:30] == 4.0).all()
    assert found[:, 39].max() == 0  # too far from any


def test_noise_does_not_move() -> None:
    rng = np.random.default_rng(1)
    images = np.clip(rng.normal(100, 4, (6, 40, 40, 3)), 0, 255).astype(np.uint8)
    images[3, 10:20, 10:20] += 60
    moves = moving_pixels(images, np.median(images, axis=0).astype(np.uint8))
    assert moves[3, 10:20, 10:20].mean() > 0.9 and moves[[0, 1, 2, 4, 5]].mean() < 0.001


def test_carving_finds_the_ball_at_each_time_in_its_colour_and_the_floor_below() -> None:
    found = carve(films(), BOX)
    assert found.found > 0.9 and found.swept > 0.2
    for time, centre in enumerate(path()):
        rows = found.times == time
        away = np.linalg.norm(found.points[rows] - centre, axis=1) - RADIUS
        assert rows.sum() > 50 and np.median(np.abs(away)) < 0.1
        assert np.abs(np.median(found.colors[rows], axis=0) - (220, 120, 60)).max() < 30
    still = found.points[~found.moving]
    shell = SHELL * 4
    inside = np.linalg.norm(still, axis=1) < 0.9 * shell
    assert np.median(np.abs(still[inside, 2] - FLOOR)) < 0.1
    np.testing.assert_allclose(np.linalg.norm(still[~inside], axis=1), shell, rtol=1e-6)


def test_points_of_a_scene_keep_to_the_budget_and_have_its_times() -> None:
    points, line = carved_points(scene_of(films()), 1500, np.random.default_rng(0))
    assert points is not None and points.times is not None
    assert len(points.positions) == len(points.times) == 1500
    assert set(points.times[np.isfinite(points.times)]) <= set(map(float, range(TIMES)))
    assert "carved from 5 cameras" in line


def test_cameras_under_each_others_names_are_refused_before_training() -> None:
    found = films()
    images = [film.images for film in found]  # two of five: all, turned by one place, are a turned scene
    swapped = [replace(film, images=images[place]) for film, place in zip(found, (1, 0, 2, 3, 4))]
    with pytest.raises(ValueError, match="a wrong calibration, cameras under each other's names"):
        carved_points(scene_of(swapped), 1500, np.random.default_rng(0))


def test_a_held_out_camera_that_looks_elsewhere_is_named_before_training() -> None:
    scene = scene_of(films())
    away = np.diag([-1.0, 1.0, -1.0, 1.0]) @ scene.test[0].camera.world_to_cam  # turned round where it stands
    beside = replace(scene.test[0], camera=replace(scene.test[0].camera, world_to_cam=away))
    none = replace(beside.camera, fx=20 * FOCAL, fy=20 * FOCAL)  # a telescope between the points
    assert covered_share(np.zeros((0, 3)), none) == 0
    _, line = carved_points(scene, 1500, np.random.default_rng(0))
    assert "held out" not in line
    _, line = carved_points(replace(scene, test=(replace(beside, camera=none),)), 1500, np.random.default_rng(0))
    assert "cam0, held out, sees them in less than 40 % of its image" in line


def test_many_cameras_are_left_to_structure_from_motion() -> None:
    found = films()[:1] * 17
    points, why = carved_points(scene_of(found), 1500, np.random.default_rng(0))
    assert points is None and why == "17 cameras that stand still, not 2 to 16"


def test_one_moving_camera_is_no_rig() -> None:
    points, why = carved_points(replace(scene_of(films()), capture="monocular"), 1500, np.random.default_rng(0))
    assert points is None and why == "each time is seen from one place"


def prepared(folder: Path, source: str, log: list[str], background_model: str = "none") -> Prepared:
    """Of the films as videos with a calibration."""
    tables = []
    for number, film in enumerate(films()):
        write_video(folder / f"cam{number}.mp4", list(film.images))
        pose = film.camera.world_to_cam
        tables.append(
            f'[cam{number}]\nname = "cam{number}"\nsize = [{WIDTH}, {HEIGHT}]\n'
            f"matrix = [[{FOCAL}, 0, {WIDTH / 2 - 0.5}], [0, {FOCAL}, {HEIGHT / 2 - 0.5}], [0, 0, 1]]\n"
            f"rotation = {pose[:3, :3].tolist()}\ntranslation = {pose[:3, 3].tolist()}\n"
        )
    (folder / "rig.toml").write_text("".join(tables))
    scene = SceneConfig(
        name="rig", reader="video", path=str(folder), calibration=str(folder / "rig.toml"), downscale=1,
        cache=str(folder / "cache"), background_model=background_model,
    )  # fmt: skip
    return prepare(Config(scene=scene, init=InitConfig(source=source), threads=1), log.append)


def test_a_run_carves_where_structure_from_motion_finds_too_few(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def finds_none(*_: object) -> None:
        raise TooFewPoints("rig: expected at least 100 points, found 0")

    monkeypatch.setattr("pipeline.data.prepare.structure_from_motion", finds_none)
    lines: list[str] = []
    found = prepared(tmp_path, "auto", lines)
    assert found.points == "carved" and found.cloud is None
    assert found.scene.points is not None and np.isfinite(found.scene.points.times).any()
    assert any("carved from 4 cameras" in line for line in lines)
    with pytest.raises(TooFewPoints, match="found 0"):
        prepared(tmp_path, "sfm", lines)
    alone = prepared(tmp_path, "auto", lines, background_model="sphere")
    assert alone.settings.background_model == "none" and any("none in place of sphere" in line for line in lines)


def test_gaussians_last_as_long_as_their_points() -> None:
    """Sizes are those of points of one time, which others do not make smaller."""
    square = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
    positions = np.concatenate([square, square + 0.01])
    points = ScenePoints(positions, np.full((8, 3), 128, np.uint8), np.array([2.0] * 4 + [np.nan] * 4), span=0.5)
    scene = scene_of(films())
    model = from_timed_points(points, scene, Config())
    torch.testing.assert_close(model.parameters["mean"][:, 3], torch.tensor([2.0] * 4 + [TIMES / 2] * 4))
    lasting = torch.tensor([0.5] * 4 + [float(TIMES)] * 4)
    torch.testing.assert_close(model.parameters["log_scale"][:, 3].exp(), lasting)
    size = np.sqrt((1 + 1 + 2) / 3)
    torch.testing.assert_close(model.parameters["log_scale"][:, 0].exp(), torch.full((8,), float(size)))
