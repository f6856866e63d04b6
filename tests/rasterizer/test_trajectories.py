"""Shared trajectories: the splines against SciPy's, rotations against SciPy's, and the kernel in extreme cases."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from builders import generator, make_request, random_gaussians
from scipy.interpolate import BSpline
from scipy.spatial.transform import Rotation
from test_kernel_vs_reference import check_against_reference

from rasterizer import Gaussians, Gradients, Rasterizer
from rasterizer.reference.render import moved, quaternion_product, turning
from rasterizer.trajectories import LEVELS, Trajectories, level_intervals

SPAN = (-0.3, 1.7)


def random_trajectories(intervals: int, count: int, size: float = 1.0) -> Trajectories:
    still = Trajectories.still(count, intervals, SPAN)
    points = size * torch.randn(still.control_points.shape, generator=generator(intervals), dtype=torch.float64)
    return Trajectories(points, SPAN)


def with_trajectories(gaussians: Gaussians, trajectories: Trajectories, weights: torch.Tensor) -> Gaussians:
    return replace(gaussians, weights=weights, trajectories=trajectories)


@pytest.mark.parametrize("intervals", [2, 4, 11, 32])
def test_values_and_drift_are_those_of_scipys_splines(intervals: int):
    """The sum over levels of cubic splines with uniform knots; drift is their derivative, or a difference quotient.
    Exact up to float64 rounding."""
    trajectories = random_trajectories(intervals, 4)
    splines, first = [], 0
    for n in LEVELS[len(trajectories.control_points)]:
        knots = SPAN[0] + (SPAN[1] - SPAN[0]) / n * np.arange(-3, n + 4)
        points = trajectories.control_points[first : first + n + 3].numpy()
        splines.append(BSpline(knots, points, 3))
        first += n + 3
    assert (first, n) == (len(trajectories.control_points), intervals)
    for time in np.linspace(*SPAN, 23):
        value, slope = sum(s(time) for s in splines), sum(s(time, 1) for s in splines)[:, :3]
        np.testing.assert_allclose(trajectories.values(time), value, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(trajectories.drift(time, 0.0), slope, rtol=1e-11, atol=1e-11)
        later = sum(s(min(time + 0.1, SPAN[1])) for s in splines)
        np.testing.assert_allclose(trajectories.drift(time, 0.1), (later - value)[:, :3] / 0.1, rtol=1e-10, atol=1e-10)


def test_levels_halve_the_intervals_down_to_two():
    assert [level_intervals(n) for n in (2, 3, 22)] == [(2,), (2, 3), (2, 3, 6, 11, 22)]
    assert len(LEVELS) == 4095, "the number of control points says which levels there are"


def test_trajectories_stand_still_before_and_after_their_span():
    trajectories = random_trajectories(8, 2)
    for end, outside in ((SPAN[0], SPAN[0] - 1e6), (SPAN[1], SPAN[1] + 1e-3), (SPAN[1], 1e30)):
        assert torch.equal(trajectories.values(end), trajectories.values(outside))
        assert not trajectories.drift(outside, 0.0).any()


@pytest.mark.parametrize("size", [0.0, 1e-8, 1e-3, 0.999, 1.001, 3.0, 3.2, 30.0])
def test_rotation_vectors_turn_by_any_angle(size: float):
    """Past π too; float64 rounding."""
    vectors = size * torch.nn.functional.normalize(torch.randn(50, 3, generator=generator(1), dtype=torch.float64))
    expected = Rotation.from_rotvec(vectors.numpy()).as_quat(scalar_first=True)
    found = turning(vectors).numpy()
    found *= np.sign((found * expected).sum(axis=1, keepdims=True))
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_the_reference_has_the_gradient_of_finite_differences():
    """Of a random function of the moved Gaussians, by weights, control points and quaternions."""
    gaussians, trajectories = random_gaussians(6, "velocity", generator(2)), random_trajectories(4, 3)

    def function(weights: torch.Tensor, points: torch.Tensor, quaternions: torch.Tensor):
        given = with_trajectories(replace(gaussians, quat_left=quaternions), Trajectories(points, SPAN), weights)
        place, drift = moved(given, 0.4, 0.2)
        return place.mean, place.quat_left, drift

    weights = torch.randn(6, 3, generator=generator(3), dtype=torch.float64)
    leaves = [t.clone().requires_grad_() for t in (weights, trajectories.control_points, gaussians.quat_left)]
    assert torch.autograd.gradcheck(function, leaves)


@pytest.mark.parametrize("angle", [1e-4, 0.3, 0.99, 1.01, 3.3, 20.0])
@pytest.mark.parametrize("time", [0.45, SPAN[0] - 1, SPAN[1], SPAN[1] + 1])
def test_the_kernel_turns_gaussians_by_any_angle_at_any_time(angle: float, time: float):
    """Around 1 rad, where the kernel's series begins, past π, and beyond the ends of the trajectories."""
    trajectories = random_trajectories(4, 3)
    points = trajectories.control_points.clone()
    points[:, :, :3] *= 0.1
    points[:, :, 3:] *= angle
    gaussians = random_gaussians(60, "velocity", generator(4))
    gaussians = replace(gaussians, mean=gaussians.mean.index_fill(1, torch.tensor(3), time))
    weights = torch.randn(60, 3, generator=generator(5), dtype=torch.float64)
    moving = with_trajectories(gaussians, Trajectories(points, SPAN), weights).to(torch.float32).to(torch.float64)
    check_against_reference(moving, make_request(time=time, outputs=("color", "flow"), flow_dt=0.1))


def test_weights_of_zero_leave_every_bit():
    gaussians = random_gaussians(300, "velocity", generator(6)).to(torch.float32)
    moving = with_trajectories(
        gaussians, Trajectories(torch.randn(12, 4, 6, generator=generator(7)), SPAN), torch.zeros(300, 4)
    )
    request = make_request(outputs=("color", "depth", "flow"), flow_dt=0.1)
    rasterizer = Rasterizer(threads=1)
    expected, found = (rasterizer.render(g, request) for g in (gaussians, moving))
    for name in request.outputs:
        assert torch.equal(getattr(found, name), getattr(expected, name)), name


def test_many_gaussians_on_one_trajectory():
    """Its gradient is a sum over all of them. The reference adds them up in float64; the kernel in float32, in chunks
    whose order does not depend on the threads."""
    gaussians = random_gaussians(3000, "velocity", generator(8), sh_degree=0, fourier_order=0, log_scale=(-4.5, -3.5))
    points = torch.zeros(5, 1, 6, dtype=torch.float64)
    points[2, 0] = torch.tensor([0.1, -0.2, 0.1, 0.5, -0.4, 0.3])
    weights = torch.ones(3000, 1, dtype=torch.float64)
    moving = with_trajectories(gaussians, Trajectories(points, SPAN), weights).to(torch.float32).to(torch.float64)
    request = make_request()
    check_against_reference(moving, request)

    single = moving.to(torch.float32)
    d_color = torch.randn(3, request.camera.height, request.camera.width, generator=generator(9))
    found = []
    for threads in (1, 3):
        rasterizer, gradients = Rasterizer(threads), Gradients.zeros_like(single)
        rasterizer.render(single, request)
        rasterizer.backward(gradients, d_color=d_color)
        found.append(gradients.dense())
    for name, tensor in found[0].items():
        assert torch.equal(tensor, found[1][name]), name


@pytest.mark.parametrize(
    ("weights", "points", "message"),
    [
        (torch.zeros(5, 3), None, "both be given"),
        (None, torch.zeros(5, 3, 6), "both be given"),
        (torch.zeros(5, 2), torch.zeros(5, 3, 6), r"weights must be \[5, 3\]"),
        (torch.zeros(5, 3), torch.zeros(6, 3, 6), "C among"),
        (torch.zeros(5, 3), torch.zeros(5, 3, 5), "C, K, 6"),
    ],
)
def test_wrong_shapes_are_refused(weights: torch.Tensor | None, points: torch.Tensor | None, message: str):
    gaussians = random_gaussians(5, "velocity", generator(1)).to(torch.float32)
    with pytest.raises(ValueError, match=message):
        replace(gaussians, weights=weights, trajectories=None if points is None else Trajectories(points))


@pytest.mark.parametrize("motion", ["full", "static"])
def test_only_separable_models_have_weights(motion: str):
    gaussians = random_gaussians(5, motion, generator(1)).to(torch.float32)
    with pytest.raises(ValueError, match="weights must be None"):
        replace(gaussians, weights=torch.zeros(5, 1), trajectories=Trajectories(torch.zeros(5, 1, 6)))


def test_quaternion_products_compose_rotations():
    a, b = (
        torch.nn.functional.normalize(torch.randn(9, 4, generator=generator(s), dtype=torch.float64)) for s in (1, 2)
    )
    rotation = lambda q: Rotation.from_quat(q.numpy(), scalar_first=True)  # noqa: E731
    np.testing.assert_allclose(
        rotation(quaternion_product(a, b)).as_matrix(), (rotation(a) * rotation(b)).as_matrix(), atol=1e-12
    )
