"""The compiled kernel against its float64 twin, for every model and output, and the identities it must keep.

Tolerances. The kernel is float32: an image may differ from the twin by 2e-4 of its largest value and a gradient by
1e-4 of its tensor's largest, about ten times what is seen. Gaussians and pixels next to a jump are left out; see
`builders` for which and why, and `assert_images_agree` for how few they are.
"""

from __future__ import annotations

import math
import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from builders import (ALL_OUTPUTS, away_from_jumps, camera_looking_at, generator, off_centre_camera, output_weights,
                      outputs_of, random_gaussians, render, render_and_gradients, rotated_world, smooth_pixels)
from rasterizer import Camera, Gaussians, Request, RenderOutput, rasterize, reference
from rasterizer.kernel import available_isas

MOTIONS = ("full", "separable", "static")
IMAGE_TOLERANCE = 2e-4
GRADIENT_TOLERANCE = 1e-4


def make_request(**changes) -> Request:
    return replace(Request(off_centre_camera(), time=0.45, duration=0.8, background=(0.3, 0.6, 0.1)), **changes)


def assert_images_agree(found: RenderOutput, expected: RenderOutput, smooth: Tensor) -> None:
    assert smooth.float().mean() > 0.9, "more than a tenth of the pixels are left out: compare a simpler scene"
    for name in ALL_OUTPUTS:
        image, truth = getattr(found, name), getattr(expected, name)
        assert (image is None) == (truth is None)
        if truth is not None:
            scale = max(1e-3, truth.abs().max().item())
            error = ((image - truth).abs() * smooth).max().item()
            assert image.dtype == torch.float32 and error <= IMAGE_TOLERANCE * scale, f"{name}: {error} of {scale}"


def assert_gradients_agree(found: dict[str, Tensor], expected: dict[str, Tensor]) -> None:
    for name, truth in expected.items():
        error, largest = (found[name] - truth).abs(), truth.abs().max().item() if truth.numel() else 0.0
        assert torch.isfinite(found[name]).all(), name
        if truth.numel():
            assert error.max().item() <= GRADIENT_TOLERANCE * largest + 1e-12, (
                f"{name}: off by {error.max().item():.2e}, the largest being {largest:.2e}")


def check_against_twin(gaussians: Gaussians, request: Request) -> None:
    """Images and all gradients of float64 `gaussians`, rendered in float32, against the twin."""
    gaussians = away_from_jumps(gaussians, request)
    smooth = smooth_pixels(gaussians, request)
    weights = output_weights(request, smooth, generator(99))
    expected, truth = render_and_gradients(reference.rasterize, gaussians, request, weights)
    found, gradients = render_and_gradients(rasterize, gaussians.to(torch.float32), request, weights)
    assert_images_agree(found, expected, smooth)
    assert_gradients_agree(gradients, truth)


# ---- Against the twin --------------------------------------------------------------------------------------


@pytest.mark.parametrize("output", ALL_OUTPUTS)
@pytest.mark.parametrize("motion", MOTIONS)
def test_each_output_alone(motion: str, output: str):
    if output not in outputs_of(motion):
        pytest.skip("a static model has no temporal statistics")
    check_against_twin(random_gaussians(70, motion, generator(1)), make_request(outputs=(output,), flow_dt=0.2))


@pytest.mark.parametrize("motion", MOTIONS)
def test_core_all_outputs_together(motion: str):
    request = make_request(outputs=outputs_of(motion), flow_dt=0.2)
    check_against_twin(random_gaussians(70, motion, generator(2)), request)


@pytest.mark.parametrize("fourier_order", [0, 1, 2])
@pytest.mark.parametrize("sh_degree", [0, 1, 2, 3])
@pytest.mark.parametrize("motion", MOTIONS)
def test_every_size_of_sh(motion: str, sh_degree: int, fourier_order: int):
    if motion == "static" and fourier_order > 0:
        pytest.skip("a static model has Fourier order 0")
    gaussians = random_gaussians(35, motion, generator(3), sh_degree=sh_degree, fourier_order=fourier_order)
    check_against_twin(gaussians, make_request())


@pytest.mark.parametrize(("sh_degree", "fourier_order"), [(0, 0), (2, 1), (1, 2), (3, 0)])
def test_limits_on_what_is_stored(sh_degree: int, fourier_order: int):
    request = make_request(sh_degree=sh_degree, fourier_order=fourier_order)
    check_against_twin(random_gaussians(35, "full", generator(4)), request)


@pytest.mark.parametrize("count", [1, 15, 16, 17, 33])
@pytest.mark.parametrize("motion", MOTIONS)
def test_counts_around_the_vector_width(motion: str, count: int):
    gaussians = random_gaussians(count, motion, generator(5))
    if motion != "static":
        gaussians.log_scale[:, 3] = 0.0  # all of them present
    check_against_twin(gaussians, make_request(outputs=outputs_of(motion), flow_dt=0.2))


@pytest.mark.parametrize("size", [(1, 1), (16, 16), (17, 5), (3, 50)])
def test_sizes_around_the_tile(size: tuple[int, int]):
    camera = camera_looking_at((0.3, 0.2, -3), *size, focal=max(size) * 1.1)
    request = make_request(camera=camera)
    gaussians = away_from_jumps(random_gaussians(40, "full", generator(6)), request)
    # Too few pixels to leave a tenth out: images only where smooth, gradients likewise, by the weights.
    smooth = smooth_pixels(gaussians, request)
    weights = output_weights(request, smooth, generator(7))
    expected, truth = render_and_gradients(reference.rasterize, gaussians, request, weights)
    found, gradients = render_and_gradients(rasterize, gaussians.to(torch.float32), request, weights)
    assert ((found.color - expected.color).abs() * smooth).max() <= IMAGE_TOLERANCE * expected.color.max()
    assert_gradients_agree(gradients, truth)


def test_core_many_opaque_gaussians_end_pixels_early():
    """A crowd in which most pixels end before their last Gaussian: what lies behind must get no gradient."""
    gaussians = random_gaussians(600, "full", generator(8), log_scale=(-2.5, -1.0), opacity_logit=(3.0, 8.0),
                                 sh_degree=1)
    request = away = make_request(outputs=("color", "alpha"))
    gaussians = away_from_jumps(gaussians, away)
    smooth = smooth_pixels(gaussians, request)
    weights = output_weights(request, smooth, generator(9))
    expected, truth = render_and_gradients(reference.rasterize, gaussians, request, weights)
    found, gradients = render_and_gradients(rasterize, gaussians.to(torch.float32), request, weights)
    assert (expected.alpha > 1 - 1e-3).float().mean() > 0.3
    assert smooth.float().mean() > 0.5  # a crowd has a jump near many a pixel
    for name in ("color", "alpha"):
        assert ((getattr(found, name) - getattr(expected, name)).abs() * smooth).max() < 5e-4
    assert_gradients_agree(gradients, truth)


def test_large_and_distant_and_near():
    """Gaussians wider than the image, thinner than a pixel, outside the frustum's clamp, all round the camera."""
    gaussians = random_gaussians(80, "full", generator(10), log_scale=(-6.0, 0.3))
    camera = camera_looking_at((0.2, 0.1, -0.6), focal=30.0)
    check_against_twin(gaussians, make_request(camera=camera, outputs=("color", "depth")))


@pytest.mark.parametrize("ratio", [1e2, 1e4])
def test_long_fast_streaks(ratio: float):
    """Axis ratios at which the textbook conditional covariance is indefinite in float32.

    What float32 can hold of such a Gaussian is itself uncertain to about 1e-7 × ratio, hence the image alone, loosely.
    """
    gaussians = random_gaussians(40, "full", generator(11), opacity_logit=(-1.0, 0.0))
    gaussians.log_scale[:, 0] = math.log(0.5)
    gaussians.log_scale[:, 1:3] = math.log(0.5 / ratio)
    gaussians = gaussians.to(torch.float32).to(torch.float64)
    request = make_request()
    gaussians = away_from_jumps(gaussians, request)
    smooth = smooth_pixels(gaussians, request, margin=1e-2)
    expected, found = render(reference.rasterize, gaussians, request), render(rasterize, gaussians.to(torch.float32), request)
    assert ((found.color - expected.color).abs() * smooth).max() < max(2e-4, 1e-6 * ratio)


# ---- Rules -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("motion", MOTIONS)
def test_core_no_gaussian_is_background(motion: str):
    weights = {"color": torch.ones(3, 37, 45)}
    out, gradients = render_and_gradients(rasterize, random_gaussians(0, motion, generator(12)).to(torch.float32),
                                          make_request(), weights)
    assert torch.equal(out.color, torch.tensor([0.3, 0.6, 0.1])[:, None, None].expand(3, 37, 45))
    assert all(gradient.numel() == 0 for gradient in gradients.values())


def one_gaussian(mean: tuple[float, ...], log_scale: float = -1.5, color: float = 1.0) -> Gaussians:
    """A static (3 coordinates) or separable (4) round Gaussian, nearly opaque, of one colour (sh0 of colour - ½)."""
    sh = torch.full((1, 1, 3), (color - 0.5) * 2 * math.sqrt(math.pi))
    return Gaussians(torch.tensor([mean]), torch.full((1, len(mean)), log_scale), torch.tensor([[1.0, 0, 0, 0]]), None,
                     torch.tensor([4.0]), sh)


def join(*parts: Gaussians) -> Gaussians:
    return Gaussians(**{"quat_right": None, **{name: torch.cat([p.tensors()[name] for p in parts])
                                               for name in parts[0].tensors()}})


def front_camera(width: int = 31, height: int = 23) -> Camera:
    return Camera(width, height, 40.0, 40.0, width / 2, height / 2, np.eye(4))


def test_coincident_depths_blend_in_the_order_of_their_rows():
    """All on the plane z = 3, where float32 has the depth exactly: the order is that of the rows, in both programs."""
    gaussians = random_gaussians(60, "static", generator(13), log_scale=(-2.5, -1.5))
    gaussians.mean[:, :2] *= 0.7
    gaussians.mean[:, 2] = 3.0
    request = make_request(camera=front_camera())
    smooth = smooth_pixels(gaussians, request)
    expected = render(reference.rasterize, gaussians, request)
    assert_images_agree(render(rasterize, gaussians.to(torch.float32), request), expected, smooth)
    first, second = one_gaussian((0, 0, 3), color=1.0), one_gaussian((0, 0, 3), color=0.0)
    center = (slice(None), 11, 15)
    assert (rasterize(join(first, second), front_camera()).color[center] > 0.9).all()
    assert (rasterize(join(second, first), front_camera()).color[center] < 0.1).all()


def test_the_near_plane_cuts():
    gaussians = one_gaussian((0, 0, 0.5))
    assert rasterize(gaussians, front_camera(), near=0.4, outputs=("alpha",)).alpha.max() > 0.9
    for near in (0.5, 0.6):  # z > near, strictly
        assert rasterize(gaussians, front_camera(), near=near, outputs=("alpha",)).alpha.max() == 0


def test_a_gaussian_far_from_its_time_contributes_nothing():
    """p(t) = 0.05 at √(2 ln 20) = 2.4477 standard deviations."""
    sigma = math.exp(-1.5)
    for deviations, present in ((2.44, True), (2.455, False)):
        gaussians = one_gaussian((0, 0, 3, 0.5))
        weights = {"alpha": torch.ones(1, 23, 31)}
        request = make_request(camera=front_camera(), time=0.5 + deviations * sigma, outputs=("alpha",))
        out, gradients = render_and_gradients(rasterize, gaussians, request, weights)
        assert (out.alpha.max() > 0).item() is present
        assert any(gradient.abs().max() > 0 for gradient in gradients.values()) is present


def test_alpha_is_capped_and_the_cap_passes_no_gradient():
    gaussians = replace(one_gaussian((0, 0, 3), log_scale=3.0), opacity_logit=torch.tensor([9.0]))
    weights = {"alpha": torch.ones(1, 23, 31)}
    out, gradients = render_and_gradients(rasterize, gaussians, make_request(camera=front_camera(), outputs=("alpha",)),
                                          weights)
    torch.testing.assert_close(out.alpha, torch.full((1, 23, 31), 0.99), rtol=0, atol=1e-6)
    assert gradients["opacity_logit"].item() == 0 and gradients["mean"].abs().max() == 0


def test_colour_is_clamped_at_zero_and_the_clamp_passes_no_gradient():
    gaussians = one_gaussian((0, 0, 3))
    gaussians.sh[0, 0] = torch.tensor([-3.0, 0.0, 3.0])
    request = make_request(camera=front_camera(), background=(0, 0, 0))
    out, gradients = render_and_gradients(rasterize, gaussians, request, {"color": torch.ones(3, 23, 31)})
    assert out.color[0].max() == 0 and out.color[2].max() > 1
    assert gradients["sh"][0, 0, 0] == 0 and gradients["sh"][0, 0, 1] > 0 and gradients["sh"][0, 0, 2] > 0


def test_a_zero_quaternion_is_the_identity():
    gaussians = random_gaussians(20, "full", generator(14)).to(torch.float32)
    zero, one = torch.zeros(20, 4), torch.tensor([1.0, 0, 0, 0]).repeat(20, 1)
    images = [rasterize(replace(gaussians, quat_left=q, quat_right=q), off_centre_camera(), time=0.5).color
              for q in (zero, one)]
    assert torch.equal(*images)
    _, gradients = render_and_gradients(rasterize, replace(gaussians, quat_left=zero), make_request(),
                                        {"color": torch.ones(3, 37, 45)})
    assert gradients["quat_left"].abs().max() == 0 and torch.isfinite(gradients["quat_right"]).all()


# ---- Identities --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("motion", MOTIONS)
def test_a_world_rotated_with_its_camera_looks_the_same(motion: str):
    request = make_request(outputs=("color", "depth"))
    gaussians = away_from_jumps(random_gaussians(50, motion, generator(15), sh_degree=0), request)
    turned, camera = rotated_world(gaussians, request.camera, torch.tensor([0.3, -0.5, 0.7, 0.4], dtype=torch.float64))
    before = render(rasterize, gaussians.to(torch.float32), request)
    after = render(rasterize, turned.to(torch.float32), replace(request, camera=camera))
    smooth = smooth_pixels(gaussians, request)
    assert ((after.color - before.color).abs() * smooth).max() < IMAGE_TOLERANCE
    assert ((after.depth - before.depth).abs() * smooth).max() < IMAGE_TOLERANCE * before.depth.max()


@pytest.mark.parametrize("motion", ["full", "separable"])
def test_a_4d_gaussian_without_motion_is_the_static_one_at_any_time(motion: str):
    """Its deviation in time is 1e4 durations: float32 must not let that leak into space."""
    static = away_from_jumps(random_gaussians(50, "static", generator(16)), make_request())
    count = len(static)
    pad = lambda t, value: torch.cat([t, torch.full((count, 1), value, dtype=t.dtype)], dim=1)  # noqa: E731
    timed = replace(static, mean=pad(static.mean, 0.5), log_scale=pad(static.log_scale, math.log(1e4)))
    if motion == "full":
        # One turn of space alone, and the same one for the static model, from a 4D pair that keeps t: l k r = k.
        identity, camera = torch.tensor([1.0, 0, 0, 0], dtype=torch.float64).repeat(count, 1), off_centre_camera()
        as_4d = replace(timed, quat_left=identity, quat_right=identity)
        left = torch.tensor([0.3, -0.5, 0.7, 0.4], dtype=torch.float64)
        timed = replace(as_4d, **{name: getattr(rotated_world(as_4d, camera, left)[0], name)
                                  for name in ("quat_left", "quat_right")})
        static = replace(static, quat_left=rotated_world(replace(static, quat_left=identity), camera, left)[0].quat_left)
    expected = rasterize(static.to(torch.float32), off_centre_camera(), background=(0.3, 0.6, 0.1)).color
    smooth = smooth_pixels(static, make_request())
    for instant in (0.0, 0.5, 3.0):
        found = rasterize(timed.to(torch.float32), off_centre_camera(), time=instant, background=(0.3, 0.6, 0.1)).color
        # cos(2πn (t-μt)/T) of coefficients that are not there: the static model has Fourier order 0.
        assert ((found - expected).abs() * smooth).max() < IMAGE_TOLERANCE


def test_flow_is_the_displacement_of_an_opaque_gaussian_that_moves():
    """A turn by θ in the x-t plane gives the speed sinθ cosθ (sx² - st²)/(sin²θ sx² + cos²θ st²) along x, by hand."""
    theta, sx, st, depth, delta, elapsed = 0.5, 0.2, 0.6, 4.0, 0.15, 0.1
    speed = (math.sin(theta) * math.cos(theta) * (sx**2 - st**2)
             / ((math.sin(theta) * sx) ** 2 + (math.cos(theta) * st) ** 2))
    turn = torch.tensor([[math.cos(theta / 2), 0, 0, math.sin(theta / 2)]])
    gaussians = Gaussians(torch.tensor([[0.0, 0, depth, 0.5]]), torch.tensor([[sx, 0.2, 0.2, st]]).log(), turn, turn,
                          torch.tensor([6.0]), torch.zeros(1, 1, 3))
    out = rasterize(gaussians, front_camera(), time=0.5 + elapsed, outputs=("flow", "alpha", "depth", "stats"),
                    flow_dt=delta)
    covered = out.alpha[0] > 0.5
    assert covered.sum() > 4
    flow, mean_depth = out.flow[:, covered] / out.alpha[:, covered], out.depth[:, covered] / out.alpha[:, covered]
    torch.testing.assert_close(flow[0], torch.full_like(flow[0], 40 * speed * delta / depth), rtol=1e-4, atol=0)
    torch.testing.assert_close(flow[1], torch.zeros_like(flow[1]), rtol=0, atol=1e-4)
    torch.testing.assert_close(mean_depth, torch.full_like(mean_depth, depth), rtol=1e-5, atol=0)
    # the centre of the visible mass lies where the motion has brought it: x = speed × elapsed
    column = (out.alpha[0].sum(0) * (torch.arange(31) + 0.5)).sum() / out.alpha[0].sum()
    assert abs(column - (15.5 + 40 * speed * elapsed / depth)) < 0.05
    variance = (math.sin(theta) * sx) ** 2 + (math.cos(theta) * st) ** 2
    stats = out.stats[:, covered] / out.alpha[:, covered]
    torch.testing.assert_close(stats, torch.tensor([[0.5], [variance]]).expand_as(stats), rtol=1e-4, atol=0)


def test_flow_that_would_pass_the_near_plane_is_left_out():
    """The one moving Gaussian of the turn above, now along z and towards the camera."""
    theta = 0.5
    turn = torch.tensor([[math.cos(theta / 2), 0, 0, math.sin(theta / 2)]])
    gaussians = Gaussians(torch.tensor([[0.0, 0, 1.0, 0.5]]), torch.tensor([[0.05, 0.2, 0.2, 0.6]]).log(), turn, turn,
                          torch.tensor([6.0]), torch.zeros(1, 1, 3))
    sideways = np.array([[0.0, 0, -1, 1], [0, 1, 0, 0], [1, 0, 0, 1], [0, 0, 0, 1]])  # looks along x, from x = -1
    camera = Camera(31, 23, 40.0, 40.0, 15.5, 11.5, sideways)
    for delta, expect_flow in ((0.1, True), (1000.0, False), (-1000.0, True)):
        request = make_request(camera=camera, time=0.5, outputs=("flow",), flow_dt=delta)
        truth = render(reference.rasterize, gaussians.to(torch.float64), request).flow
        found, gradients = render_and_gradients(rasterize, gaussians, request, {"flow": torch.ones(2, 23, 31)})
        torch.testing.assert_close(found.flow, truth.float(), rtol=1e-3, atol=1e-4)
        assert (truth.abs().max() > 1e-3).item() is expect_flow
        assert all(torch.isfinite(gradient).all() for gradient in gradients.values())


# ---- Instruction sets --------------------------------------------------------------------------------------


@pytest.mark.parametrize("isa", available_isas())
def test_every_instruction_set_of_this_machine(isa: str):
    """The core tests once more, in a process that is told which kernel to load."""
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-k", "core", __file__]
    done = subprocess.run(command, env={**os.environ, "RASTERIZER_ISA": isa}, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-1000:]
