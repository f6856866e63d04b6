"""From a driving log to a scene: held-out frames, selection, hidden points, masks of sky and of what moves."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import kitti_folder as k
import numpy as np
import pytest

from datasets.composition import BLACK
from datasets.files.errors import SceneError
from datasets.readers.kitti import open_kitti
from datasets.scene import Sweep
from datasets.settings import SceneConfig
from datasets.source import open_source
from datasets.urban.assemble import scene_of_log
from datasets.urban.moving import RangeImage, moving_mask, moving_points
from datasets.urban.projection import hidden, project, seen
from datasets.urban.sky import estimate_sky
from rasterizer.camera import Camera


def config(path: Path, **changes: object) -> SceneConfig:
    return SceneConfig(name="kitti/04", reader="kitti", path=str(path), **{"downscale": 1, **changes})


def frames(views: tuple) -> list[int]:
    return sorted({view.frame for view in views})


def test_every_nth_frame_is_held_out_with_all_its_cameras_and_its_sweep(tmp_path: Path) -> None:
    folder = k.write_odometry(tmp_path, 9)
    lines: list[str] = []
    scene = open_source(config(folder, test_every=4), log=lines.append).scene()
    assert frames(scene.test) == [3, 7] and frames(scene.train) == [0, 1, 2, 4, 5, 6, 8]
    assert len(scene.test) == 4 and [sweep.frame for sweep in scene.test_sweeps] == [3, 7]
    assert frames(scene.sweeps) == frames(scene.train) and "every 4th frame" in lines[0]
    assert scene.test_split == "every 4th frame"


def test_validation_holds_out_training_frames_instead(tmp_path: Path) -> None:
    scene = open_source(
        config(k.write_odometry(tmp_path, 9), test_every=4, validation_every=4), log=lambda line: None
    ).scene()
    assert frames(scene.test) == [2, 8] and not {3, 7} & set(frames(scene.train + scene.test))


def test_frames_and_cameras_are_selected(tmp_path: Path) -> None:
    folder = k.write_odometry(tmp_path, 9)
    scene = open_source(
        config(folder, first_frame=2, frames=5, log_cameras=[3], test_every=5), log=lambda line: None
    ).scene()
    assert frames(scene.train + scene.test) == [2, 3, 4, 5, 6] and frames(scene.test) == [6]
    assert {view.name for view in scene.test} == {"test/cam3_000006"}
    for key, wrong in (
        ("log_cameras", [1]), ("first_frame", 50), ("test_every", 10), ("validation_every", 30),
        ("background", "white"), ("sky_masks", "files"),
    ):  # fmt: skip
        with pytest.raises(SceneError, match=f"scene.{key}: expected"):
            open_source(config(folder, **{key: wrong}), log=str).scene()
    assert open_source(config(folder, background=[0.0, 0.0, 0.0]), log=str).scene().background == BLACK, "of a run"
    with pytest.raises(SceneError, match="scene.validation_outermost: expected false for a driving log"):
        open_source(config(folder, validation_every=4, validation_outermost=True), log=str).scene()


def test_cameras_that_are_triggered_one_after_another_are_several(tmp_path: Path) -> None:
    """KITTI's cameras have times of their own, tenths of a millisecond apart: no two images have the same."""
    scene = open_source(config(k.write_raw(tmp_path, 9), test_every=9)).scene()
    assert len({view.time for view in scene.train}) == len(scene.train) == 16
    assert scene.capture == "drive" and scene.several_cameras and scene.frame_count == 8
    of_one = sorted(view.time for view in scene.train if "cam2" in view.name)
    assert scene.frame_spacing == pytest.approx((of_one[-1] - of_one[0]) / 7, rel=1e-9)
    alone = open_source(config(k.write_raw(tmp_path / "alone", 9), test_every=9, log_cameras=[2])).scene()
    assert not alone.several_cameras


def test_truth_of_distorted_images_is_not_read(tmp_path: Path) -> None:
    log = open_kitti(k.write_odometry(tmp_path, 9))
    bent = (0.05, 0.0, 0.0, 0.0, 0.0)
    images = tuple(replace(i, truth=i.path, distortion=bent if i.number == 3 else ()) for i in log.images)
    scene = scene_of_log(replace(log, images=images), config(tmp_path, test_every=4))
    assert {(view.name.split("/")[1][:4], view.truth is None) for view in scene.train} == {
        ("cam2", False),
        ("cam3", True),
    }


FRONT = Camera(400, 200, 300.0, 300.0, 200.0, 100.0, np.eye(4))


def grid(x: tuple[float, float], y: tuple[float, float], z: float, step: float) -> np.ndarray:
    across, down = np.meshgrid(np.arange(*x, step), np.arange(*y, step))
    return np.stack([across.ravel(), down.ravel(), np.full(across.size, z)], axis=1)


def test_nearer_surfaces_hide_points_and_the_road_hides_none() -> None:
    """A board at 10 m before a wall at 30 m, both densely measured, and a road, nearer below any of its points."""
    board, wall = grid((-1, 1), (-1, 1), 10.0, 0.08), grid((-9, 9), (-6, 1.4), 30.0, 0.25)
    road = np.stack([np.zeros(40), np.full(40, 1.6), np.linspace(6, 45, 40)], axis=1)
    points = np.concatenate([board, wall, road])
    kept = np.zeros(len(points), bool)
    kept[seen(points, FRONT)[0]] = True
    behind = (np.abs(wall[:, 0]) < 2.8) & (np.abs(wall[:, 1]) < 2.8)
    beside = (np.abs(wall[:, 0]) > 3.5) | (wall[:, 1] < -3.7)
    of_wall, of_road = kept[len(board) : -40], kept[-40:]
    assert kept[: len(board)].all() and not of_wall[behind].any() and of_wall[beside].all()
    assert of_road[road[:, 2] < 9].all()
    assert not hidden(*project(road, FRONT), FRONT).any()


def test_points_move_if_other_sweeps_saw_through_their_place() -> None:
    """A box that passes a wall: its points move, those of the wall do not; the mask holds the box's image."""
    wall = grid((-12, 12), (-2, 2), 25.0, 0.1)
    sweeps = []
    for frame in range(9):
        box = grid((-6 + 1.6 * frame, -4 + 1.6 * frame), (-1, 1), 15.0, 0.06)
        shadow = np.abs(wall[:, 0] - 25 / 15 * (-5 + 1.6 * frame)) < 1.75
        shadow &= np.abs(wall[:, 1]) < 1.7
        sweeps.append(Sweep(frame, 0.1 * frame, np.zeros(3), np.concatenate([box, wall[~shadow]])))
    axes = np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]])
    images = [RangeImage.of(sweep, axes) for sweep in sweeps]
    now = sweeps[4]
    moving = moving_points(now, images[:4] + images[5:])
    is_box = now.points[:, 2] == 15.0
    assert moving[is_box].mean() > 0.95 and moving[~is_box].mean() < 0.02
    mask = moving_mask(now.points[moving], FRONT)
    column, row, _ = project(now.points[is_box], FRONT)
    assert mask[row.astype(int), column.astype(int)].all()
    box_area = (np.ptp(column) + 1) * (np.ptp(row) + 1)
    assert mask.sum() < 1.6 * box_area  # the discs around its border


def test_sky_is_the_bright_region_at_the_top_above_the_lidar() -> None:
    rng = np.random.default_rng(0)
    image = rng.integers(20, 90, (80, 120, 3)).astype(np.uint8)
    image[:30] = (150, 180, 230)
    image[50:, 60:] = 240  # a white van, below
    image[:30, 100:] = rng.integers(10, 60, (30, 20, 3))  # a tree
    depth = np.zeros((80, 120), np.float32)
    depth[20:, 10:20] = 12.0  # a white wall as bright as the sky, which the LiDAR hits
    found = estimate_sky(image, depth)
    truth = np.zeros((80, 120), bool)
    truth[:30, :100] = True
    truth[20:, 8:22] = False
    assert (found & truth).sum() > 0.9 * truth.sum() and (found & ~truth).sum() < 0.02 * truth.sum()
    assert not estimate_sky(rng.integers(20, 90, (80, 120, 3)).astype(np.uint8)).any()
