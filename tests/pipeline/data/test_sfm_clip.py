"""Cameras of one clip: a rendered clip of a room in which things move, and a camera that stands still."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from datasets.source import Photograph
from datasets.synthetic.rig import rig
from datasets.synthetic.scenes import counter
from datasets.synthetic.trace import trace
from pipeline.config.schema import InitConfig
from pipeline.data.sfm.clip import reconstruct_clip
from pipeline.data.sfm.moving_masks import fundamental_matrix
from pipeline.data.sfm.reconstruction import Reconstruction
from pipeline.evaluation.pictures.camera_path import look_at
from rasterizer.camera import Camera

COUNT = 14


def filmed(count: int = COUNT, arc: float = 0.5, turn: float = 0.0) -> tuple[list[Photograph], list[Camera]]:
    """The kitchen counter, `count` frames in half a second, on an arc of `arc` radians, and turning by `turn` radians.

    The arc is in front of the counter; 0 is one place.
    """
    world = counter.build(np.random.default_rng(0))
    intrinsics = rig(3, 240, 180, np.random.default_rng(0))[0]
    photographs, cameras = [], []
    for index in range(count):
        along = index / (count - 1) - 0.5
        angle = arc * along
        position = np.array([3.2 * np.sin(angle), -3.2 * np.cos(angle), 0.6 + 0.3 * angle])
        aim = position + [3.5 * np.sin(turn * along - angle), 3.5 * np.cos(turn * along - angle), -0.6]
        pose = look_at(position, np.array([0.0, 0.3, 0.0]) if turn == 0 else aim, np.array([0.0, 0.0, -1.0]))
        camera = Camera(240, 180, intrinsics.fx, intrinsics.fy, 120, 90, pose)
        image = trace(world, camera, 0.5 * index / count, samples=1).color
        photographs.append(Photograph(f"frame_{index:05d}", np.rint(255 * image.transpose(1, 2, 0)).astype(np.uint8)))
        cameras.append(camera)
    return photographs, cameras


def test_poses_of_a_rendered_clip() -> None:
    photographs, truth = filmed()
    lines: list[str] = []
    found = reconstruct_clip(photographs, InitConfig(min_points=50), Path("clip"), lines.append)
    assert f"of {COUNT} frames registered" in lines[0]
    check_poses(found, truth)


def test_a_clip_whose_second_pass_finds_less_keeps_the_first() -> None:
    """As JPEG, the frames give masks without which COLMAP finds no more than three cameras."""
    photographs, truth = filmed(12)
    coded = [cv2.imencode(".jpg", photograph.image, [cv2.IMWRITE_JPEG_QUALITY, 75])[1] for photograph in photographs]
    photographs = [replace(p, image=np.asarray(cv2.imdecode(c, cv2.IMREAD_COLOR))) for p, c in zip(photographs, coded)]
    lines: list[str] = []
    check_poses(reconstruct_clip(photographs, InitConfig(min_points=50), Path("clip"), lines.append), truth)
    assert len(lines) == 1 or "12 of 12" in lines[1] or "the first pass is used" in lines[2]


def check_poses(found: Reconstruction, truth: list[Camera]) -> None:
    """95 % of the cameras, within 5 % of the path's length and 2 degrees."""
    names = sorted(found.cameras)
    assert len(names) >= 0.95 * len(truth)
    expected = np.stack([truth[int(name[-5:])].position for name in names])
    positions = np.stack([found.cameras[name].camera.position for name in names])
    turns = np.stack([found.cameras[name].camera.world_to_cam[:3, :3] for name in names])
    true_turns = np.stack([truth[int(name[-5:])].world_to_cam[:3, :3] for name in names])
    rotation, scale, shift = similarity(turns, true_turns, positions, expected)
    path = np.linalg.norm(np.diff(expected, axis=0), axis=1).sum()
    assert np.linalg.norm(scale * positions @ rotation.T + shift - expected, axis=1).max() < 0.05 * path
    cosines = (np.einsum("nij,kj,nik->n", turns, rotation, true_turns) - 1) / 2
    assert np.degrees(np.arccos(np.clip(cosines, -1, 1))).max() < 2


def test_a_camera_that_stands_still_is_refused() -> None:
    photographs, _ = filmed(8, arc=0.0)
    with pytest.raises(
        ValueError, match="^clip: expected a camera that moves, found one that stands still .*walk side"
    ):
        reconstruct_clip(photographs, InitConfig(), Path("clip"), lambda line: None)


def test_a_camera_that_only_turns_is_refused() -> None:
    photographs, _ = filmed(10, arc=0.0, turn=0.6)
    with pytest.raises(ValueError, match="^clip: expected .*the camera turns without moving, .*walk sideways"):
        reconstruct_clip(photographs, InitConfig(), Path("clip"), lambda line: None)


def test_fewer_than_four_fifths_of_the_frames_are_refused() -> None:
    """Noise in the place of three frames of ten."""
    photographs, _ = filmed(10)
    rng = np.random.default_rng(0)
    for index in (2, 5, 8):
        noise = rng.integers(0, 256, photographs[index].image.shape, np.uint8)
        photographs[index] = replace(photographs[index], image=noise)
    with pytest.raises(ValueError, match="^clip: expected to find the camera of 80% of 10 frames, found that of 7: "):
        reconstruct_clip(photographs, InitConfig(min_points=10), Path("clip"), lambda line: None)


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


def similarity(
    turns: np.ndarray, true_turns: np.ndarray, positions: np.ndarray, expected: np.ndarray
) -> tuple[np.ndarray, float, np.ndarray]:
    """(R, s, t): the rotation from the cameras' own, as a short path hardly bends; s and t from the positions."""
    u, _, vt = np.linalg.svd(np.einsum("nij,nik->jk", true_turns, turns))
    rotation = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    a, b = (positions - positions.mean(axis=0)) @ rotation.T, expected - expected.mean(axis=0)
    scale = float((a * b).sum() / (a**2).sum())
    return rotation, scale, expected.mean(axis=0) - scale * rotation @ positions.mean(axis=0)
