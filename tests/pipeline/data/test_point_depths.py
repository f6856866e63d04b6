"""Depth targets of structure from motion's points, before a wall of two colours."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from test_lidar_points import BLUE, FOCAL, HEIGHT, RED, WALL, WIDTH, drive
from tiny import tiny_config, tiny_scene, train_tiny

from datasets.scene import ScenePoints
from pipeline.config.train_schema import DensifyConfig, DepthConfig
from pipeline.data.depth_targets import PointDepths
from pipeline.training.objective.image_terms import inverse_depth
from rasterizer import Rasterizer, Request

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


def test_a_longer_focal_length_at_the_same_place_has_its_own_pixels() -> None:
    scene, points = drive(), ScenePoints(np.array([at_pixel(COLUMN, ROW, WALL)]), np.array([RED], np.uint8))
    first = scene.train[0]
    camera = replace(first.camera, fx=2 * first.camera.fx, cx=first.camera.cx + 4)
    depths = PointDepths(replace(scene, train=[first, replace(first, camera=camera)]), points)
    red = (torch.tensor(RED).view(3, 1, 1) / 255).expand(3, HEIGHT, WIDTH)
    found = [depths.at(index, c, red) for index, c in enumerate((first.camera, camera))]
    column = (COLUMN + 0.5 - WIDTH / 2) * 2 + WIDTH / 2 + 4
    assert [f is not None and f.pixel.tolist() for f in found] == [[ROW * WIDTH + COLUMN], [ROW * WIDTH + int(column)]]


def test_the_loss_moves_the_rendered_depth_to_the_points(tmp_path: Path) -> None:
    """Points on the disc of the first view, nearer than its Gaussians: with the loss their inverse depth is nearer to
    the points'; half the error is the margin."""
    scene = tiny_scene(static=True)
    view = scene.train[0]
    row, column = np.nonzero(np.asarray(view.image).any(axis=2))
    rays = np.stack([(column + 0.5 - 16) / 40, (row + 0.5 - 16) / 40, np.ones(len(row))], axis=1)
    rotation, shift = view.camera.world_to_cam[:3, :3], view.camera.world_to_cam[:3, 3]
    positions = (3.2 * rays - shift) @ rotation
    points = ScenePoints(positions, np.asarray(view.image)[row, column])
    scene = replace(scene, train=scene.train[:1], points=points)
    errors = []
    for weight in (0.0, 5.0):
        cfg = tiny_config(batch=1, densify=DensifyConfig(start=100), depth=DepthConfig(sfm=weight))
        model = train_tiny(tmp_path / str(weight), cfg, scene).model
        request = Request(view.camera, 0.0, 1.0, scene.background, outputs=("color", "alpha", "depth"))
        image = Rasterizer(threads=1).render(model.gaussians(), request, differentiable=False)
        rho = inverse_depth(image.depth, image.alpha)[0][0].numpy()[row, column]
        errors.append(float(np.abs(rho - 1 / 3.2).mean()))
    assert errors[1] < 0.5 * errors[0]
