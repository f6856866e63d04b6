"""Depth targets of structure from motion's points, before a wall of two colours."""

from __future__ import annotations

import numpy as np
import torch
from test_lidar_points import BLUE, FOCAL, HEIGHT, RED, WALL, WIDTH, drive

from datasets.scene import ScenePoints
from pipeline.data.sfm.depth_targets import PointDepths

COLUMN, ROW = 4, 11  # of a pixel on the red half


def at_pixel(column: float, row: float, depth: float) -> list[float]:
    """The point at the centre of a pixel of the first view."""
    x, y = (column + 0.5 - WIDTH / 2) / FOCAL, (row + 0.5 - HEIGHT / 2) / FOCAL
    return [x * depth, y * depth, depth]


def shown(index: int) -> torch.Tensor:
    return torch.from_numpy(drive().train[index].image.astype(np.float32) / 255).permute(2, 0, 1).contiguous()


def test_a_point_counts_where_and_while_the_pixel_has_its_colour() -> None:
    positions = [at_pixel(COLUMN, ROW, WALL), at_pixel(COLUMN + 1, ROW, 0.5 * WALL), at_pixel(COLUMN, ROW, -WALL)]
    scene, points = drive(), ScenePoints(np.array(positions), np.array([RED, BLUE, RED], np.uint8))
    found = PointDepths(scene, points).at(0, scene.train[0].camera, shown(0))
    assert found is not None and found.pixel.tolist() == [ROW * WIDTH + COLUMN]
    torch.testing.assert_close(found.inverse, torch.tensor([1 / WALL], dtype=torch.float32))
    covered = shown(0)
    covered[:, ROW, COLUMN] += 0.2  # something else is before it
    assert PointDepths(scene, points).at(0, scene.train[0].camera, covered) is None


def test_the_nearest_point_of_a_pixel_counts_at_any_size_and_from_any_camera() -> None:
    scene = drive()
    points = ScenePoints(
        np.array([at_pixel(COLUMN, ROW, WALL), at_pixel(COLUMN, ROW, 20.0)]), np.array([RED, RED], np.uint8)
    )
    depths = PointDepths(scene, points)
    red = torch.tensor(RED).view(3, 1, 1) / 255
    for index in (0, 1, 0):  # the car moves by 2 a frame
        for size in ((WIDTH, HEIGHT), (WIDTH // 2, HEIGHT // 2)):
            camera = scene.train[index].camera.resized(*size)
            found = depths.at(index, camera, red.expand(3, camera.height, camera.width))
            assert found is not None and found.inverse.max().item() == np.float32(1 / (20.0 - 2 * index))
            assert index > 0 or len(found.pixel) == 1  # the farther one is hidden
