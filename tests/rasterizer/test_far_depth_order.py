"""Depth order of Gaussians so far away that their depths are equal in float32, against the float64 reference.

Means lie near the origin, where float32 is precise; the camera is up to 1e7 units away, where float32 steps by a whole
unit. A wrong order changes images by 1e-2 to 0.5 of full scale. In the right order errors are at most 1e-6 for images
and 1e-5 for gradients, as at any distance, so the tolerances are those of `test_kernel_vs_reference.py`.
"""

from __future__ import annotations

import math
import os
from dataclasses import replace

import numpy as np
import pytest
import torch
from builders import (
    MOTIONS,
    camera_looking_at,
    generator,
    output_weights,
    outputs_of,
    random_gaussians,
    render_and_gradients,
    uniform,
)

from pipeline.studies.kernel_stability.instruction_sets import images_and_gradients, same_bits
from rasterizer import Camera, Gaussians, Request, rasterize
from rasterizer.kernel_loader import ISA_VARIABLE, available_isas
from rasterizer.reference import render as reference
from rasterizer.reference.discontinuities import FAR_NEAR_PLANES, smooth_pixels

COUNT = 20
WIDTH, HEIGHT = 40, 32
IMAGE_TOLERANCE, GRADIENT_TOLERANCE = 3e-5, 1e-4
FLOW_SCALE = 1.0  # pixels: flow is a difference of two pixel positions, each precise to 1e-6 of the image in float32


def camera_at(distance: float, rotated: bool, focal: float) -> Camera:
    """A camera at this distance that looks at the origin; rotated: its axes are not aligned with the world's."""
    if rotated:
        direction = np.array([0.3, -0.5, -0.8])
        return camera_looking_at(direction / np.linalg.norm(direction) * distance, WIDTH, HEIGHT, focal)
    pose = np.eye(4)
    pose[2, 3] = distance
    return Camera(WIDTH, HEIGHT, focal, focal * 1.1, WIDTH / 2, HEIGHT / 2, pose)


def gaussians_along_axis(
    camera: Camera, motion: str, gap: float, unit: float, logit: float, count: int = COUNT, aside: float = 0.0
) -> Gaussians:
    """Gaussians about the origin, `gap` world units apart along the optical axis, rows in random order.

    unit: their size, about. aside: maximum distance from the axis. They hardly move, so the means decide the order.
    """
    rng = generator(7)
    gaussians = random_gaussians(count, motion, rng, sh_degree=1, fourier_order=1, log_scale=(-1.5, -0.3))
    gaussians.log_scale[:, :3] += math.log(unit)
    behind = gap * (torch.randperm(count, generator=rng) - count / 2)
    across = aside * uniform((count, 2), -1, 1, rng)
    in_camera = torch.cat([across, behind[:, None].to(torch.float64)], dim=1)
    gaussians.mean[:, :3] = in_camera @ torch.tensor(camera.world_to_cam[:3, :3].copy())
    if motion != "static":
        gaussians.log_scale[:, 3] = 0.0
        gaussians.mean[:, 3] = 0.45
    gaussians.opacity_logit[:] = logit
    return gaussians.to(torch.float32).to(torch.float64)


def request_for(camera: Camera, motion: str, **changes) -> Request:
    return replace(
        Request(camera, time=0.45, duration=0.8, background=(0.3, 0.6, 0.1), outputs=outputs_of(motion), flow_dt=0.1),
        **changes,
    )


def color_request(camera: Camera, **changes) -> Request:
    return replace(Request(camera, time=0.45, background=(0.3, 0.6, 0.1)), **changes)


def color_of(gaussians: Gaussians, request: Request, **arguments) -> torch.Tensor:
    return rasterize(
        gaussians.to(torch.float32),
        request.camera,
        time=request.time,
        background=request.background,
        near=request.near,
        **arguments,
    ).color


def check_against_reference(gaussians: Gaussians, request: Request, isa: str | None = None) -> None:
    """Compare images and gradients at smooth pixels, no Gaussian excluded. isa: None for RASTERIZER_ISA or the best."""
    smooth = smooth_pixels(gaussians, request)
    assert smooth.float().mean() > 0.9
    weights = output_weights(request, smooth, generator(9))
    expected, _ = render_and_gradients(reference.rasterize, gaussians, request, weights)
    scale = {
        name: max(FLOW_SCALE if name == "flow" else 1e-3, getattr(expected, name).abs().max().item())
        for name in request.outputs
    }
    weights = {name: weight / scale[name] for name, weight in weights.items()}  # outputs weigh equally
    _, truth = render_and_gradients(reference.rasterize, gaussians, request, weights)
    isa = isa or os.environ.get(ISA_VARIABLE) or available_isas()[0]
    images, gradients = images_and_gradients(isa, 1, gaussians.to(torch.float32), request, weights)
    for name, image in images.items():
        error = ((image - getattr(expected, name)).abs() * smooth).max().item()
        assert error <= IMAGE_TOLERANCE * scale[name], f"{name}: {error} of {scale[name]}"
    for name, exact in truth.items():
        error, largest = (gradients[name] - exact).abs().max().item(), exact.abs().max().item()
        assert error <= GRADIENT_TOLERANCE * largest, f"{name}: {error} of {largest}"


# ---- Against the reference implementation ------------------------------------------------------------------


@pytest.mark.parametrize(
    ("distance", "gap"), [(1e4, 5e-3), (1e4, 1e-4), (1e5, 5e-3), (1e6, 5e-3), (1e6, 1e-5), (1e7, 5e-3)]
)
@pytest.mark.parametrize("rotated", [False, True], ids=["along_axes", "rotated"])
@pytest.mark.parametrize("motion", MOTIONS)
def test_large_distant_gaussians_that_overlap(motion: str, rotated: bool, distance: float, gap: float):
    """Large in world units, and transparent enough that the last one contributes."""
    camera = camera_at(distance, rotated, focal=40.0)
    gaussians = gaussians_along_axis(camera, motion, gap, 0.1 * distance, logit=-1.0)
    if motion == "full":  # no motion: at this size it would exceed the gap
        gaussians = replace(gaussians, quat_right=gaussians.quat_left * torch.tensor([1, -1, -1, -1]))
    check_against_reference(gaussians, request_for(camera, motion))


@pytest.mark.parametrize("distance", [1e4, 1e5, 1e6, 1e7])
@pytest.mark.parametrize("rotated", [False, True], ids=["along_axes", "rotated"])
@pytest.mark.parametrize("motion", MOTIONS)
def test_small_distant_gaussians_through_a_telephoto_lens(motion: str, rotated: bool, distance: float):
    """One world unit is 8 pixels, so that a float32 position 1e7 units away would be off by 8 pixels."""
    camera = camera_at(distance, rotated, focal=8 * distance)
    gaussians = gaussians_along_axis(camera, motion, 5e-3, 1.0, logit=0.0, aside=1.0)
    check_against_reference(gaussians, request_for(camera, motion))


@pytest.mark.parametrize("isa", available_isas())
@pytest.mark.parametrize("motion", MOTIONS)
def test_every_instruction_set(motion: str, isa: str):
    camera = camera_at(1e6, True, focal=8e6)
    gaussians = gaussians_along_axis(camera, motion, 5e-3, 1.0, logit=0.0, aside=1.0)
    check_against_reference(gaussians, request_for(camera, motion), isa)


@pytest.mark.parametrize("logit", [-3.0, 0.0, 3.0])
def test_opacities_from_faint_to_opaque(logit: float):
    camera = camera_at(1e6, True, focal=8e6)
    gaussians = gaussians_along_axis(camera, "separable", 5e-3, 1.0, logit, aside=1.5)
    check_against_reference(gaussians, request_for(camera, "separable"))


def test_near_and_far_gaussians_in_one_view():
    """Every other Gaussian is 3 units in front of a camera 2²⁰ units from the origin, where float32 steps by 1/8."""
    camera = camera_at(2.0**20, False, focal=40.0)
    gaussians = gaussians_along_axis(camera, "static", 5e-3, 1e5, logit=-1.0)
    gaussians.mean[::2, 2] = torch.arange(COUNT // 2) / 8 + 3 - 2.0**20
    gaussians.log_scale[::2] -= math.log(1e5)
    check_against_reference(gaussians, request_for(camera, "static"))


# ---- Properties --------------------------------------------------------------------------------------------


def nearly_equal_depths(camera: Camera) -> Gaussians:
    """Several chunks of Gaussians, all within 24 float32 steps of depth, a hundred exactly coincident."""
    gaussians = gaussians_along_axis(camera, "separable", 5e-4, 1e5, logit=-6.0, count=3000)
    for name in ("mean", "log_scale", "quat_left"):
        getattr(gaussians, name)[1000:1100] = getattr(gaussians, name)[1000]
    return gaussians


@pytest.mark.parametrize("isa", available_isas())
def test_any_number_of_threads_gives_the_same_bits(isa: str):
    camera = camera_at(1e6, True, focal=40.0)
    gaussians, request = nearly_equal_depths(camera).to(torch.float32), color_request(camera)
    weights = {"color": torch.randn((3, HEIGHT, WIDTH), generator=generator(3))}
    one, *others = (images_and_gradients(isa, threads, gaussians, request, weights) for threads in (1, 2, 3))
    for other in others:
        for a, b in zip(one, other, strict=True):
            assert all(same_bits(a[name], b[name]) for name in a)


def test_row_order_matters_only_for_near_gaussians_with_equal_depths():
    """Far Gaussians are ordered by depth alone, so permuted rows give the same bits; near ties are ordered by row."""
    for distance, independent in ((1e6, True), (4.0, False)):
        camera = camera_at(distance, True, focal=40.0)
        gap = 5e-3 if independent else 1e-8
        gaussians = gaussians_along_axis(camera, "separable", gap, 0.1 * distance, logit=0.0)
        reversed_rows = gaussians.rows(torch.arange(len(gaussians)).flip(0))
        request = color_request(camera)
        assert torch.equal(color_of(gaussians, request), color_of(reversed_rows, request)) is independent


def test_coincident_far_gaussians_keep_the_order_of_their_rows():
    camera = camera_at(1e6, True, focal=40.0)
    gaussians = gaussians_along_axis(camera, "separable", 0.0, 1e5, logit=0.0)
    check_against_reference(gaussians, request_for(camera, "separable"))


# ---- The distance from which depths are compared in float64 ------------------------------------------------


@pytest.mark.parametrize("near", [0.2, 1.0])
@pytest.mark.parametrize(
    ("near_planes", "far"),
    [(20, False), (5000, False), (0.99 * FAR_NEAR_PLANES, False), (1.01 * FAR_NEAR_PLANES, True)],
)
def test_float64_depth_order_begins_at_far_near_planes(near_planes: float, far: bool, near: float):
    """Gaps below float32 resolution change no bit before FAR_NEAR_PLANES near planes; beyond, they decide the order."""
    distance = near_planes * near
    camera = camera_at(distance, False, focal=40.0)
    gaussians = gaussians_along_axis(camera, "static", 1e-10 * distance, 0.1 * distance, logit=0.0)
    without_gaps = replace(gaussians, mean=gaussians.mean * torch.tensor([1.0, 1, 0]))
    request = color_request(camera, near=near)
    assert torch.equal(color_of(gaussians, request), color_of(without_gaps, request)) is not far
    truth = reference.rasterize(gaussians, camera, time=0.45, background=request.background, near=near).color
    assert ((color_of(gaussians, request) - truth).abs().max() < 1e-5).item() is far


def test_a_near_plane_at_the_camera_compares_all_depths_in_float64():
    camera = camera_at(4.0, True, focal=40.0)
    gaussians = gaussians_along_axis(camera, "full", 1e-9, 0.4, logit=0.0)
    gaussians = replace(gaussians, quat_right=gaussians.quat_left * torch.tensor([1, -1, -1, -1]))
    check_against_reference(gaussians, request_for(camera, "full", near=0.0))
