"""Spatial rotation and tilt of a 4D rotation, against the rotation matrix."""

from __future__ import annotations

import torch
from builders import generator

from pipeline.model.tilt import UNTILTED, left_and_right, spatial_and_tilt
from rasterizer.covariance import rotation_4d


def random_quaternions(seed: int, count: int = 50) -> tuple[torch.Tensor, torch.Tensor]:
    left, right = torch.randn(2, count, 4, generator=generator(seed), dtype=torch.float64)
    return left, right


def test_a_rotation_of_space_alone_has_no_tilt() -> None:
    left, _ = random_quaternions(1)
    right = left * UNTILTED.double()
    rotation = rotation_4d(left, right)
    torch.testing.assert_close(rotation[:, 3], torch.tensor([0.0, 0, 0, 1]).double().expand(50, 4), atol=1e-14, rtol=0)


def test_the_coordinates_are_orthogonal_and_have_an_inverse() -> None:
    left, right = random_quaternions(2)
    spatial, tilted = spatial_and_tilt(left, right)
    # 1e-14: float64 rounding of numbers of about 1
    for found, expected in zip(left_and_right(spatial, tilted), (left, right)):
        torch.testing.assert_close(found, expected, rtol=0, atol=1e-14)
    length = spatial.square().sum(dim=1) + tilted.square().sum(dim=1)
    torch.testing.assert_close(length, left.square().sum(dim=1) + right.square().sum(dim=1), rtol=1e-14, atol=0)


def test_tilt_coordinates_separate_rotation_from_velocity() -> None:
    """The change of the last row of the rotation, by steps of 1e-6 along each coordinate."""
    left, change = random_quaternions(3)
    right, nothing, step = left * UNTILTED.double(), torch.zeros_like(change), 1e-6
    before = rotation_4d(left, right)
    for coordinates, turns_time in (((change, nothing), False), ((nothing, change), True)):
        d_left, d_right = left_and_right(*coordinates)
        turned = (rotation_4d(left + step * d_left, right + step * d_right) - before) / step
        # Second-order terms are about the step, 1e-6; the quaternions' lengths are between 0.5 and 3.
        assert (turned[:, 3].norm(dim=1) > 1e-2).all() if turns_time else turned[:, 3].abs().max() < 1e-4
        assert (turned[:, :3, :3].flatten(1).norm(dim=1) > 1e-2).all() or turns_time
