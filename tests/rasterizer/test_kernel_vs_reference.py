"""The compiled kernel against the float64 reference implementation, for every model, output and instruction set.

Tolerances. The kernel is float32: an image may differ by 3e-5 of its largest value and a gradient by 1e-4 of its
tensor's largest; random scenes show at most 5e-6 and 1.5e-5. Gaussians and pixels near a discontinuity are excluded
(rasterizer/reference/discontinuities.py): about 0.4 % of the pixels, asserted to be under 10 %.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch
from builders import (
    MOTIONS,
    camera_looking_at,
    generator,
    make_request,
    output_weights,
    outputs_of,
    random_gaussians,
    render,
    render_and_gradients,
)
from scipy.spatial.transform import Rotation
from torch import Tensor

from pipeline.studies.kernel_stability.instruction_sets import images_and_gradients
from rasterizer import Gaussians, RenderOutput, Request, rasterize
from rasterizer.kernel_loader import available_isas, kernel
from rasterizer.reference import render as reference
from rasterizer.reference.discontinuities import away_from_discontinuities, smooth_pixels
from rasterizer.request import OUTPUT_NAMES, RELEASED_GRADIENTS

IMAGE_TOLERANCE = 3e-5
GRADIENT_TOLERANCE = 1e-4


def assert_images_agree(found: RenderOutput, expected: RenderOutput, smooth: Tensor) -> None:
    assert smooth.float().mean() > 0.9, "more than a tenth of the pixels are excluded: compare a simpler scene"
    for name in OUTPUT_NAMES:
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
                f"{name}: error {error.max().item():.2e}, largest gradient {largest:.2e}"
            )


Program = Callable[[Gaussians, Request, dict[str, Tensor]], tuple[RenderOutput, dict[str, Tensor]]]


def with_autograd(gaussians: Gaussians, request: Request, weights: dict[str, Tensor]):
    """(images, gradients) of `rasterize`, which has the kernel of RASTERIZER_ISA or the best one."""
    return render_and_gradients(rasterize, gaussians, request, weights)


def by_instruction_set(isa: str) -> Program:
    """The same by the kernel of this instruction set, without autograd."""

    def program(gaussians: Gaussians, request: Request, weights: dict[str, Tensor]):
        images, gradients = images_and_gradients(isa, 1, gaussians, request, weights)
        return RenderOutput(**dict.fromkeys(OUTPUT_NAMES) | images), gradients

    return program


OTHER_ISAS = [isa for isa in available_isas() if not kernel.__name__.endswith(f"_{isa}")]
EVERY_INSTRUCTION_SET = pytest.mark.parametrize(
    "program",
    [with_autograd, *map(by_instruction_set, OTHER_ISAS)],
    ids=["rasterize", *(f"instruction_set_{isa}" for isa in OTHER_ISAS)],
)


def check_against_reference(gaussians: Gaussians, request: Request, program: Program = with_autograd) -> None:
    """Compare images and all gradients of float64 `gaussians`, which the kernel renders in float32."""
    gaussians = away_from_discontinuities(gaussians, request)
    smooth = smooth_pixels(gaussians, request)
    weights = output_weights(request, smooth, generator(99))
    expected, truth = render_and_gradients(reference.rasterize, gaussians, request, weights)
    found, gradients = program(gaussians.to(torch.float32), request, weights)
    assert_images_agree(found, expected, smooth)
    assert_gradients_agree(gradients, truth)


# ---- Against the reference implementation ------------------------------------------------------------------


@pytest.mark.parametrize(("motion", "output"), [(m, name) for m in MOTIONS for name in outputs_of(m)])
def test_each_output_alone(motion: str, output: str):
    check_against_reference(random_gaussians(70, motion, generator(1)), make_request(outputs=(output,), flow_dt=0.2))


@EVERY_INSTRUCTION_SET
@pytest.mark.parametrize("motion", MOTIONS)
def test_all_outputs_together(motion: str, program: Program):
    request = make_request(outputs=outputs_of(motion), flow_dt=0.2)
    check_against_reference(random_gaussians(70, motion, generator(2)), request, program)


@EVERY_INSTRUCTION_SET
@pytest.mark.parametrize("released", [*((name,) for name in RELEASED_GRADIENTS), ("untrained", "wrong_line")])
@pytest.mark.parametrize("motion", MOTIONS)
def test_released_gradients(motion: str, released: tuple[str, ...], program: Program):
    """A wrong term is of the size of the gradient itself, four orders above the tolerance."""
    request = make_request(released_gradients=released)
    check_against_reference(random_gaussians(70, motion, generator(11)), request, program)


@pytest.mark.parametrize("forward", [-0.15, 2.5], ids=["back", "past_some"])
@pytest.mark.parametrize("motion", MOTIONS)
def test_flow_of_a_camera_that_moves_and_zooms(motion: str, forward: float):
    """The later camera has turned, moved, in one case past some Gaussians, and changed its lens; static Gaussians have
    flow then, too."""
    request = make_request(outputs=outputs_of(motion), flow_dt=0.2)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = Rotation.from_rotvec([0.03, 0.1, -0.02]).as_matrix(), [0.2, -0.1, -forward]
    now = request.camera
    later = replace(
        now, fx=1.1 * now.fx, fy=0.9 * now.fy, cx=now.cx + 2, cy=now.cy - 1, world_to_cam=pose @ now.world_to_cam
    )
    check_against_reference(random_gaussians(70, motion, generator(3)), replace(request, flow_camera=later))


@pytest.mark.parametrize("offset", [-0.3, 0.15])
@pytest.mark.parametrize("motion", MOTIONS)
def test_temporal_marginals_of_another_time(motion: str, offset: float):
    request = make_request(outputs=outputs_of(motion), flow_dt=0.2, marginal_offset=offset)
    check_against_reference(random_gaussians(70, motion, generator(2)), request)


@pytest.mark.parametrize("sh_degree", [0, 1, 2, 3])
@pytest.mark.parametrize(
    ("motion", "fourier_order"), [(m, order) for m in MOTIONS for order in range(1 if m == "static" else 3)]
)
def test_every_sh_degree_and_fourier_order(motion: str, sh_degree: int, fourier_order: int):
    gaussians = random_gaussians(35, motion, generator(3), sh_degree=sh_degree, fourier_order=fourier_order)
    check_against_reference(gaussians, make_request())


@pytest.mark.parametrize(("sh_degree", "fourier_order"), [(0, 0), (2, 1), (1, 2), (3, 0)])
def test_requests_for_a_lower_sh_degree_or_fourier_order(sh_degree: int, fourier_order: int):
    request = make_request(sh_degree=sh_degree, fourier_order=fourier_order)
    check_against_reference(random_gaussians(35, "full", generator(4)), request)


@pytest.mark.parametrize("count", [1, 15, 16, 17, 33])
@pytest.mark.parametrize("motion", MOTIONS)
def test_counts_around_the_vector_width(motion: str, count: int):
    gaussians = random_gaussians(count, motion, generator(5))
    if motion != "static":
        gaussians.log_scale[:, 3] = 0.0  # p(t) >= 0.05 for all of them
    check_against_reference(gaussians, make_request(outputs=outputs_of(motion), flow_dt=0.2))


@pytest.mark.parametrize("size", [(1, 1), (16, 16), (17, 5), (3, 50)])
def test_sizes_around_the_tile(size: tuple[int, int]):
    camera = camera_looking_at((0.3, 0.2, -3), *size, focal=max(size) * 1.1)
    request = make_request(camera=camera)
    gaussians = away_from_discontinuities(random_gaussians(40, "full", generator(6)), request)
    # Too few pixels for the limit of a tenth. The weights exclude the same pixels from the gradients.
    smooth = smooth_pixels(gaussians, request)
    weights = output_weights(request, smooth, generator(7))
    expected, truth = render_and_gradients(reference.rasterize, gaussians, request, weights)
    found, gradients = render_and_gradients(rasterize, gaussians.to(torch.float32), request, weights)
    assert ((found.color - expected.color).abs() * smooth).max() <= IMAGE_TOLERANCE * expected.color.max()
    assert_gradients_agree(gradients, truth)


@EVERY_INSTRUCTION_SET
def test_opaque_gaussians_end_pixels_early(program: Program):
    """Most pixels end before their last Gaussian; Gaussians behind must get no gradient."""
    gaussians = random_gaussians(
        600, "full", generator(8), log_scale=(-2.5, -1.0), opacity_logit=(3.0, 8.0), sh_degree=1
    )
    request = make_request(outputs=("color", "alpha"))
    gaussians = away_from_discontinuities(gaussians, request)
    smooth = smooth_pixels(gaussians, request)
    weights = output_weights(request, smooth, generator(9))
    expected, truth = render_and_gradients(reference.rasterize, gaussians, request, weights)
    found, gradients = program(gaussians.to(torch.float32), request, weights)
    assert (expected.alpha > 1 - 1e-3).float().mean() > 0.3
    assert smooth.float().mean() > 0.5  # many pixels are near a discontinuity
    for name in ("color", "alpha"):
        assert ((getattr(found, name) - getattr(expected, name)).abs() * smooth).max() <= IMAGE_TOLERANCE
    assert_gradients_agree(gradients, truth)


def test_all_sizes_and_distances():
    """Gaussians wider than the image, thinner than a pixel, beyond the Jacobian's clamp, all around the camera."""
    gaussians = random_gaussians(80, "full", generator(10), log_scale=(-6.0, 0.3))
    camera = camera_looking_at((0.2, 0.1, -0.6), focal=30.0)
    check_against_reference(gaussians, make_request(camera=camera, outputs=("color", "depth")))


@pytest.mark.parametrize("ratio", [1e2, 1e4])
def test_long_fast_streaks(ratio: float):
    """Axis ratios at which the textbook conditional covariance is indefinite in float32.

    Rounding the parameters to float32 alone changes the image by about 1e-7 × ratio, hence the loose tolerance.
    """
    gaussians = random_gaussians(40, "full", generator(11), opacity_logit=(-1.0, 0.0))
    gaussians.log_scale[:, 0] = math.log(0.5)
    gaussians.log_scale[:, 1:3] = math.log(0.5 / ratio)
    gaussians = gaussians.to(torch.float32).to(torch.float64)
    request = make_request()
    gaussians = away_from_discontinuities(gaussians, request)
    smooth = smooth_pixels(gaussians, request, margin=1e-2)
    expected, found = (
        render(reference.rasterize, gaussians, request),
        render(rasterize, gaussians.to(torch.float32), request),
    )
    assert ((found.color - expected.color).abs() * smooth).max() < max(2e-4, 1e-6 * ratio)


@EVERY_INSTRUCTION_SET
@pytest.mark.parametrize("motion", MOTIONS)
def test_an_empty_scene_renders_the_background(motion: str, program: Program):
    weights = {"color": torch.ones(3, 37, 45)}
    out, gradients = program(random_gaussians(0, motion, generator(12)).to(torch.float32), make_request(), weights)
    assert torch.equal(out.color, torch.tensor([0.3, 0.6, 0.1])[:, None, None].expand(3, 37, 45))
    assert not any(
        gradient.any() for gradient in gradients.values()
    )  # of the trajectories zero, of others without rows


@pytest.mark.parametrize("speed", [1.0, 1e3, 1e5])
def test_gaussians_that_come_from_far_with_a_velocity(speed: float):
    """μ(t) is in view, μ is speed × |t - μt| away: their sum in float32 would be off by 6e-8 of that, here up to 6e-3,
    which is 0.1 px. Images and gradients have the tolerances of all other tests."""
    gaussians = random_gaussians(40, "velocity", generator(12))
    request = make_request(outputs=outputs_of("velocity"), flow_dt=0.05 / speed)
    gaussians.velocity.mul_(speed)
    gaussians.mean[:, :3] -= gaussians.velocity * (request.time - gaussians.mean[:, 3:])
    check_against_reference(gaussians.to(torch.float32).to(torch.float64), request)


def test_a_large_temporal_scale_with_4d_rotation():
    """The naive M_xyz - velocity m_t cancels here: entries of 1e5 whose difference is 0.1.

    1e-4: images agree to a few 1e-6; the form that cancels is off by more than 1e-2.
    """
    gaussians = random_gaussians(40, "full", generator(12))
    gaussians.log_scale[:, 3] = math.log(1e6)
    gaussians = gaussians.to(torch.float32).to(torch.float64)
    request = make_request()
    gaussians = away_from_discontinuities(gaussians, request)
    smooth = smooth_pixels(gaussians, request)
    expected = render(reference.rasterize, gaussians, request).color
    found = render(rasterize, gaussians.to(torch.float32), request).color
    assert len(gaussians) > 0 and smooth.float().mean() > 0.5
    assert ((found.double() - expected).abs() * smooth).max() < 1e-4


def test_a_denormal_quaternion_keeps_its_rotation():
    """The inverse of its norm overflows float32; 1e-3, since a denormal of 1e-40 has only about 16 bits."""
    gaussians = random_gaussians(30, "full", generator(13))
    request = make_request()
    gaussians = away_from_discontinuities(gaussians, request)
    smooth = smooth_pixels(gaussians, request, margin=1e-2)
    expected = render(reference.rasterize, gaussians, request).color
    single = gaussians.to(torch.float32)
    single.quat_left.mul_(1e-40)
    found = render(rasterize, single, request).color
    assert ((found.double() - expected).abs() * smooth).max() < 1e-3
