"""The rules of docs/method.md 1 on the compiled kernel, one small scene each, and invariances of rendering.

Tolerance of float32 against float64 or hand calculation: 3e-5 of an image's largest value, as in
`test_kernel_vs_reference.py`.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from builders import (
    MOTIONS,
    generator,
    make_request,
    off_centre_camera,
    random_gaussians,
    render,
    render_and_gradients,
    rotated_world,
)

from rasterizer import Camera, Gaussians, rasterize
from rasterizer.reference import render as reference
from rasterizer.reference.discontinuities import away_from_discontinuities, smooth_pixels
from rasterizer.reference.render import slice_in_time

IMAGE_TOLERANCE = 3e-5


def one_gaussian(mean: tuple[float, ...], log_scale: float = -1.5, color: float = 1.0) -> Gaussians:
    """A static (mean of 3 numbers) or separable (4) isotropic Gaussian, nearly opaque and grey."""
    sh = torch.full((1, 1, 3), (color - 0.5) * 2 * math.sqrt(math.pi))
    return Gaussians(
        torch.tensor([mean]).float(),
        torch.full((1, len(mean)), log_scale),
        torch.tensor([[1.0, 0, 0, 0]]),
        None,
        torch.tensor([4.0]),
        sh,
    )


def join(*parts: Gaussians) -> Gaussians:
    return Gaussians.from_tensors({name: torch.cat([p.tensors()[name] for p in parts]) for name in parts[0].tensors()})


def front_camera(width: int = 31, height: int = 23) -> Camera:
    return Camera(width, height, 40.0, 40.0, width / 2, height / 2, np.eye(4))


def test_equal_depths_blend_in_row_order():
    """All means on the plane z = 3, exact in float32: kernel and reference implementation both use the row order."""
    gaussians = random_gaussians(60, "static", generator(13), log_scale=(-2.5, -1.5))
    gaussians.mean[:, :2] *= 0.7
    gaussians.mean[:, 2] = 3.0
    request = make_request(camera=front_camera())
    smooth = smooth_pixels(gaussians, request)
    expected = render(reference.rasterize, gaussians, request)
    found = render(rasterize, gaussians.to(torch.float32), request)
    assert smooth.float().mean() > 0.9
    assert ((found.color - expected.color).abs() * smooth).max() < IMAGE_TOLERANCE * expected.color.max()
    first, second = one_gaussian((0, 0, 3), color=1.0), one_gaussian((0, 0, 3), color=0.0)
    center = (slice(None), 11, 15)
    assert (rasterize(join(first, second), front_camera()).color[center] > 0.9).all()
    assert (rasterize(join(second, first), front_camera()).color[center] < 0.1).all()


def test_gaussians_before_the_near_plane_are_culled():
    gaussians = one_gaussian((0, 0, 0.5))
    assert rasterize(gaussians, front_camera(), near=0.4, outputs=("alpha",)).alpha.max() > 0.9
    for near in (0.5, 0.6):  # z > near, strictly
        assert rasterize(gaussians, front_camera(), near=near, outputs=("alpha",)).alpha.max() == 0


def test_gaussians_with_a_small_temporal_marginal_are_culled():
    """p(t) = 0.05 at √(2 ln 20) = 2.4477 standard deviations."""
    sigma = math.exp(-1.5)
    for deviations, rendered in ((2.44, True), (2.455, False)):
        gaussians = one_gaussian((0, 0, 3, 0.5))
        weights = {"alpha": torch.ones(1, 23, 31)}
        request = make_request(camera=front_camera(), time=0.5 + deviations * sigma, outputs=("alpha",))
        out, gradients = render_and_gradients(rasterize, gaussians, request, weights)
        assert (out.alpha.max() > 0).item() is rendered
        assert any(gradient.abs().max() > 0 for gradient in gradients.values()) is rendered


def test_alpha_is_clamped_at_0_99_without_gradient():
    gaussians = replace(one_gaussian((0, 0, 3), log_scale=3.0), opacity_logit=torch.tensor([9.0]))
    weights = {"alpha": torch.ones(1, 23, 31)}
    out, gradients = render_and_gradients(
        rasterize, gaussians, make_request(camera=front_camera(), outputs=("alpha",)), weights
    )
    torch.testing.assert_close(out.alpha, torch.full((1, 23, 31), 0.99), rtol=0, atol=1e-6)
    assert gradients["opacity_logit"].item() == 0 and gradients["mean"].abs().max() == 0


def test_colour_is_clamped_at_zero_without_gradient():
    gaussians = one_gaussian((0, 0, 3))
    gaussians.sh[0, 0] = torch.tensor([-3.0, 0.0, 3.0])
    request = make_request(camera=front_camera(), background=(0, 0, 0))
    out, gradients = render_and_gradients(rasterize, gaussians, request, {"color": torch.ones(3, 23, 31)})
    assert out.color[0].max() == 0 and out.color[2].max() > 1
    assert gradients["sh"][0, 0, 0] == 0 and gradients["sh"][0, 0, 1] > 0 and gradients["sh"][0, 0, 2] > 0


def test_a_zero_quaternion_is_the_identity():
    gaussians = random_gaussians(20, "full", generator(14)).to(torch.float32)
    zero, one = torch.zeros(20, 4), torch.tensor([1.0, 0, 0, 0]).repeat(20, 1)
    images = [
        rasterize(replace(gaussians, quat_left=q, quat_right=q), off_centre_camera(), time=0.5).color
        for q in (zero, one)
    ]
    assert torch.equal(*images)
    _, gradients = render_and_gradients(
        rasterize, replace(gaussians, quat_left=zero), make_request(), {"color": torch.ones(3, 37, 45)}
    )
    assert gradients["quat_left"].abs().max() == 0 and torch.isfinite(gradients["quat_right"]).all()


# ---- Invariances -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rasterizer", [rasterize, reference.rasterize], ids=["kernel", "reference"])
@pytest.mark.parametrize("left, top", [(40, 12), (0, 30), (70, 0)])
def test_a_crop_is_a_part_of_the_image_also_beside_the_principal_point(rasterizer, left: int, top: int):
    """The principal point of (48, 36) is left of or above two crops. The Gaussians are flat disks of 4 to 20 px at
    slants of up to 80°, which the Jacobian foreshortens by where they are; all are inside the crop, so that no clamp
    applies to either image. In float32 a pixel differs by the rounding of positions: IMAGE_TOLERANCE."""
    whole, size = Camera(96, 72, 50.0, 50.0, 48.0, 36.0, np.eye(4)), (26, 40)
    rng, count = generator(21), 25
    pixel = torch.tensor([left, top]) + torch.rand(count, 2, generator=rng, dtype=torch.float64) * torch.tensor(size)
    depth = 2 + 2 * torch.rand(count, 1, generator=rng, dtype=torch.float64)
    mean = torch.cat([(pixel - torch.tensor([48.0, 36.0])) / 50 * depth, depth], dim=1)
    gaussians = random_gaussians(count, "static", rng, log_scale=(-2.5, -1.5))
    gaussians = replace(gaussians, mean=mean)
    crop = replace(whole, width=size[0], height=size[1], cx=48.0 - left, cy=36.0 - top)
    images = [
        render(rasterizer, gaussians.to(torch.float32), make_request(camera=camera)).color for camera in (whole, crop)
    ]
    part = images[0][:, top : top + size[1], left : left + size[0]]
    assert images[1].std() > 0.05
    assert (images[1] - part).abs().max() < IMAGE_TOLERANCE * part.max()


@pytest.mark.parametrize("motion", MOTIONS)
def test_rotating_the_world_with_the_camera_changes_nothing(motion: str):
    request = make_request(outputs=("color", "depth"))
    gaussians = away_from_discontinuities(random_gaussians(50, motion, generator(15), sh_degree=0), request)
    rotated, camera = rotated_world(gaussians, request.camera, torch.tensor([0.3, -0.5, 0.7, 0.4], dtype=torch.float64))
    before = render(rasterize, gaussians.to(torch.float32), request)
    after = render(rasterize, rotated.to(torch.float32), replace(request, camera=camera))
    smooth = smooth_pixels(gaussians, request)
    assert ((after.color - before.color).abs() * smooth).max() < IMAGE_TOLERANCE
    assert ((after.depth - before.depth).abs() * smooth).max() < IMAGE_TOLERANCE * before.depth.max()


@pytest.mark.parametrize("motion", ["full", "separable"])
def test_a_marginal_offset_equals_gaussians_moved_back_in_time(motion: str):
    """A Gaussian whose μt is earlier by δ, and its position with it by velocity · δ, is on the same path."""
    offset, request = 0.15, make_request()
    gaussians = random_gaussians(50, motion, generator(17), fourier_order=0)  # colours do not depend on t - μt
    gaussians = away_from_discontinuities(gaussians, replace(request, marginal_offset=offset))
    velocity = slice_in_time(gaussians, request.time).velocity
    earlier = gaussians.mean - offset * torch.cat([velocity, torch.ones(len(gaussians), 1, dtype=torch.float64)], dim=1)
    moved = replace(gaussians, mean=earlier)
    smooth = smooth_pixels(moved, request)
    before = render(rasterize, gaussians.to(torch.float32), replace(request, marginal_offset=offset))
    after = render(rasterize, moved.to(torch.float32), request)
    unshifted = render(rasterize, gaussians.to(torch.float32), request)
    assert ((after.color - before.color).abs() * smooth).max() < IMAGE_TOLERANCE
    assert (after.color - unshifted.color).abs().max() > 0.05  # the offset matters


@pytest.mark.parametrize("motion", ["full", "separable"])
def test_a_4d_gaussian_without_motion_equals_the_static_one_at_any_time(motion: str):
    """Its temporal standard deviation is 1e4 durations, whose rounding must not change the spatial covariance."""
    static = away_from_discontinuities(random_gaussians(50, "static", generator(16)), make_request())
    count = len(static)
    pad = lambda t, value: torch.cat([t, torch.full((count, 1), value, dtype=t.dtype)], dim=1)  # noqa: E731
    timed = replace(static, mean=pad(static.mean, 0.5), log_scale=pad(static.log_scale, math.log(1e4)))
    if motion == "full":
        # A 4D quaternion pair that rotates space only (l k r = k), and the same rotation for the static model.
        identity, camera = (torch.tensor([1.0, 0, 0, 0], dtype=torch.float64).repeat(count, 1), off_centre_camera())
        as_4d = replace(timed, quat_left=identity, quat_right=identity)
        left = torch.tensor([0.3, -0.5, 0.7, 0.4], dtype=torch.float64)
        timed = replace(
            as_4d,
            **{name: getattr(rotated_world(as_4d, camera, left)[0], name) for name in ("quat_left", "quat_right")},
        )
        static = replace(
            static, quat_left=rotated_world(replace(static, quat_left=identity), camera, left)[0].quat_left
        )
    expected = rasterize(static.to(torch.float32), off_centre_camera(), background=(0.3, 0.6, 0.1)).color
    smooth = smooth_pixels(static, make_request())
    for instant in (0.0, 0.5, 3.0):
        found = rasterize(timed.to(torch.float32), off_centre_camera(), time=instant, background=(0.3, 0.6, 0.1)).color
        # Fourier order 0, as in the static model: colours do not depend on time.
        assert ((found - expected).abs() * smooth).max() < IMAGE_TOLERANCE


def test_flow_is_the_displacement_of_a_moving_opaque_gaussian():
    """Rotated by θ in the x-t plane, it moves along x at sinθ cosθ (sx² - st²)/(sin²θ sx² + cos²θ st²)."""
    theta, sx, st, depth, delta, elapsed = 0.5, 0.2, 0.6, 4.0, 0.15, 0.1
    variance = (math.sin(theta) * sx) ** 2 + (math.cos(theta) * st) ** 2  # Σtt
    speed = math.sin(theta) * math.cos(theta) * (sx**2 - st**2) / variance
    quaternion = torch.tensor([[math.cos(theta / 2), 0, 0, math.sin(theta / 2)]])
    gaussians = Gaussians(
        torch.tensor([[0.0, 0, depth, 0.5]]),
        torch.tensor([[sx, 0.2, 0.2, st]]).log(),
        quaternion,
        quaternion,
        torch.tensor([6.0]),
        torch.zeros(1, 1, 3),
    )
    out = rasterize(
        gaussians, front_camera(), time=0.5 + elapsed, outputs=("flow", "alpha", "depth", "stats"), flow_dt=delta
    )
    covered = out.alpha[0] > 0.5
    assert covered.sum() > 4
    flow, mean_depth = (out.flow[:, covered] / out.alpha[:, covered], out.depth[:, covered] / out.alpha[:, covered])
    torch.testing.assert_close(flow[0], torch.full_like(flow[0], 40 * speed * delta / depth), rtol=1e-4, atol=0)
    torch.testing.assert_close(flow[1], torch.zeros_like(flow[1]), rtol=0, atol=1e-4)
    torch.testing.assert_close(mean_depth, torch.full_like(mean_depth, depth), rtol=1e-5, atol=0)
    # the centroid of alpha has moved to x = speed × elapsed
    column = (out.alpha[0].sum(0) * (torch.arange(31) + 0.5)).sum() / out.alpha[0].sum()
    assert abs(column - (15.5 + 40 * speed * elapsed / depth)) < 0.05
    stats = out.stats[:, covered] / out.alpha[:, covered]
    torch.testing.assert_close(stats, torch.tensor([[0.5], [variance]]).expand_as(stats), rtol=1e-4, atol=0)


def test_flow_is_zero_where_the_gaussian_would_cross_the_near_plane():
    """The moving Gaussian of the test above, from a camera on its path: it approaches."""
    theta = 0.5
    quaternion = torch.tensor([[math.cos(theta / 2), 0, 0, math.sin(theta / 2)]])
    gaussians = Gaussians(
        torch.tensor([[0.0, 0.1, 0.1, 0.5]]),
        torch.tensor([[0.05, 0.2, 0.2, 0.6]]).log(),
        quaternion,
        quaternion,
        torch.tensor([6.0]),
        torch.zeros(1, 1, 3),
    )
    sideways = np.array([[0.0, 0, -1, 1], [0, 1, 0, 0], [1, 0, 0, 1], [0, 0, 0, 1]])  # looks along x, from x = -1
    camera = Camera(31, 23, 40.0, 40.0, 15.5, 11.5, sideways)
    for delta, expect_flow in ((0.1, True), (1000.0, False), (-1000.0, True)):
        request = make_request(camera=camera, time=0.5, outputs=("flow",), flow_dt=delta)
        truth = render(reference.rasterize, gaussians.to(torch.float64), request).flow
        found, gradients = render_and_gradients(rasterize, gaussians, request, {"flow": torch.ones(2, 23, 31)})
        torch.testing.assert_close(found.flow, truth.float(), rtol=1e-3, atol=1e-4)
        assert (truth.abs().max() > 1e-3).item() is expect_flow
        assert all(torch.isfinite(gradient).all() for gradient in gradients.values())


@pytest.mark.parametrize("log_time_scale", [-30.0, -36.0, -40.0, -80.0])
def test_a_gaussian_of_hardly_any_lifetime_keeps_its_size(log_time_scale: float):
    """At t = μt, without a tilt of the time axis, it looks as one that is always there."""
    gaussians = random_gaussians(1, "full", generator(3), log_scale=(-1.5, -1.5)).to(torch.float32)
    gaussians.mean[:] = torch.tensor([[0.0, 0.0, 3.0, 0.5]])
    gaussians.quat_left[:] = gaussians.quat_right[:] = torch.tensor([[1.0, 0, 0, 0]])
    images = []
    for scale in (log_time_scale, 0.0):
        gaussians.log_scale[:, 3] = scale
        images.append(rasterize(gaussians, front_camera(), time=0.5, outputs=("alpha",)).alpha)
    assert images[1].sum() > 20
    torch.testing.assert_close(images[0], images[1], rtol=0, atol=IMAGE_TOLERANCE)


@pytest.mark.parametrize("motion", ["full", "separable", "velocity"])
def test_a_huge_lifetime_has_a_finite_gradient(motion: str):
    """Σtt = exp(2 × 60) is more than float32 holds."""
    gaussians = random_gaussians(5, motion, generator(3)).to(torch.float32)
    gaussians.log_scale[:, 3] = 60.0
    for tensor in gaussians.tensors().values():
        tensor.requires_grad_()
    rasterize(gaussians, off_centre_camera(), time=0.5).color.sum().backward()
    assert gaussians.mean.grad.abs().max() > 0
    for name, tensor in gaussians.tensors().items():
        assert tensor.grad.isfinite().all(), name
