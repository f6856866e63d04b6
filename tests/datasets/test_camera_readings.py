"""Poses the wrong way round, of cameras around a point and of those that look outwards."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from datasets.camera_readings import FLIP, look_at_one_point, other_readings
from rasterizer.camera import Camera


def around(centre: np.ndarray, outwards: bool = False) -> list[Camera]:
    """Nine cameras on a helix around a point."""
    found = []
    for i, angle in enumerate(np.linspace(0, 2 * np.pi, 9, endpoint=False)):
        place = np.array([np.cos(angle), np.sin(angle), 0.1 * i]) * 3
        forward = place / np.linalg.norm(place) * (1 if outwards else -1)
        right = np.cross(forward, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        pose = np.eye(4)
        pose[:3, :3] = np.stack([right, np.cross(forward, right), forward])
        pose[:3, 3] = -pose[:3, :3] @ (place + centre)
        found.append(Camera(100, 80, 90.0, 90.0, 50.0, 40.0, pose))
    return found


@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        (np.linalg.inv, "camera-to-world and world-to-camera exchanged"),
        (lambda pose: FLIP @ pose, "the cameras' y and z axes reversed (OpenGL's or OpenCV's)"),
        (lambda pose: np.linalg.inv(FLIP @ pose), "both exchanged, and y and z reversed"),
    ],
)
def test_a_wrong_reading_is_named_and_undone(wrong, named: str) -> None:
    """Up to a turn of the world, which no image shows: relative poses are those of the right reading."""
    right = around(np.array([0.4, -0.3, 0.6]))
    assert look_at_one_point(right)
    misread = [replace(camera, world_to_cam=wrong(camera.world_to_cam)) for camera in right]
    found = other_readings(misread)[named]
    first, other_first = (np.linalg.inv(cameras[0].world_to_cam) for cameras in (found, right))
    for one, other in zip(found, right):
        np.testing.assert_allclose(one.world_to_cam @ first, other.world_to_cam @ other_first, atol=1e-9)


def test_cameras_that_look_outwards_are_only_suspected() -> None:
    """The reversed reading of a ring that looks outwards looks inwards: only images tell the two apart."""
    ring = around(np.array([0.4, -0.3, 0.6]), outwards=True)
    assert not look_at_one_point(ring) and other_readings(ring)


def test_cameras_side_by_side_or_along_a_way_are_not_suspected() -> None:
    for step in ([1.0, 0, 0], [0, 0, 1.0]):
        row = []
        for i in range(6):
            pose = np.eye(4)
            pose[:3, 3] = -i * np.array(step)
            row.append(Camera(100, 80, 90.0, 90.0, 50.0, 40.0, pose))
        assert not look_at_one_point(row) and other_readings(row) == {}
