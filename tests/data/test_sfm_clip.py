"""Cameras of one clip: a rendered clip of a room in which things move, and a camera that stands still."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from datasets.synthetic.rig import rig
from datasets.synthetic.scenes import counter
from datasets.synthetic.trace import trace
from pipeline.config.schema import InitConfig
from pipeline.data.sfm.clip import reconstruct_clip
from pipeline.data.sfm.moving_masks import fundamental_matrix
from pipeline.data.sfm.photograph import Photograph
from pipeline.evaluation.camera_path import look_at
from rasterizer.camera import Camera

COUNT = 14


def filmed(still: bool = False) -> tuple[list[Photograph], list[Camera]]:
    """The kitchen counter, on an arc in front of it or from one place, COUNT frames in half a second."""
    world = counter.build(np.random.default_rng(0))
    intrinsics = rig(3, 240, 180, np.random.default_rng(0))[0]
    photographs, cameras = [], []
    for index in range(COUNT):
        angle = 0.0 if still else 0.5 * (index / (COUNT - 1) - 0.5)
        position = np.array([3.2 * np.sin(angle), -3.2 * np.cos(angle), 0.6 + 0.3 * angle])
        pose = look_at(position, np.array([0.0, 0.3, 0.0]), np.array([0.0, 0.0, -1.0]))
        camera = Camera(240, 180, intrinsics.fx, intrinsics.fy, 120, 90, pose)
        image = trace(world, camera, 0.5 * index / COUNT, samples=1).color
        photographs.append(Photograph(f"frame_{index:05d}", np.rint(255 * image.transpose(1, 2, 0)).astype(np.uint8)))
        cameras.append(camera)
    return photographs, cameras


def test_poses_of_a_rendered_clip() -> None:
    photographs, truth = filmed()
    lines: list[str] = []
    found = reconstruct_clip(photographs, InitConfig(min_points=50), Path("clip"), lines.append)
    assert len(found.cameras) >= 0.95 * COUNT and f"of {COUNT} frames registered" in lines[0]
    names = [p.name for p in photographs if p.name in found.cameras]
    expected = np.stack([truth[int(name[-5:])].position for name in names])
    positions = np.stack([found.cameras[name].camera.position for name in names])
    rotation, scale, shift = similarity(positions, expected)
    path = np.linalg.norm(np.diff(expected, axis=0), axis=1).sum()
    assert np.linalg.norm(scale * positions @ rotation.T + shift - expected, axis=1).max() < 0.05 * path
    for name in names:
        pose = found.cameras[name].camera.world_to_cam[:3, :3] @ rotation.T
        difference = pose @ truth[int(name[-5:])].world_to_cam[:3, :3].T
        assert np.degrees(np.arccos(np.clip((np.trace(difference) - 1) / 2, -1, 1))) < 2


def test_a_camera_that_stands_still_is_refused() -> None:
    photographs, _ = filmed(still=True)
    with pytest.raises(
        ValueError, match="^clip: expected a camera that moves, found one that stands still .*walk side"
    ):
        reconstruct_clip(photographs, InitConfig(), Path("clip"), lambda line: None)


def test_points_lie_on_their_epipolar_lines() -> None:
    rng = np.random.default_rng(0)
    a, b = two_cameras()
    points = rng.uniform(-0.5, 0.5, (20, 3))
    here, there = (np.concatenate([project(camera, points), np.ones((20, 1))], axis=1) for camera in (a, b))
    assert np.abs((there @ fundamental_matrix(a, b) * here).sum(axis=1)).max() < 1e-9


def two_cameras() -> list[Camera]:
    poses = [look_at(np.array([x, -3.0, 0.2]), np.zeros(3), np.array([0.0, 0.0, -1.0])) for x in (0.0, 0.4)]
    return [Camera(240, 180, 300, 310, 118, 95, pose) for pose in poses]


def project(camera: Camera, points: np.ndarray) -> np.ndarray:
    x, y, z = camera.world_to_cam[:3, :3] @ points.T + camera.world_to_cam[:3, 3:]
    return np.stack([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy], axis=1)


def similarity(source: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, float, np.ndarray]:
    """(R, s, t) of the least squares s R x + t (Umeyama 1991)."""
    means = source.mean(axis=0), target.mean(axis=0)
    a, b = source - means[0], target - means[1]
    u, d, vt = np.linalg.svd(b.T @ a)
    signs = np.array([1, 1, np.linalg.det(u @ vt)])
    rotation = u @ np.diag(signs) @ vt
    scale = float((d * signs).sum() / (a**2).sum())
    return rotation, scale, means[1] - scale * rotation @ means[0]
