"""Gaussians so far away that float32 cannot tell their depths apart, against the float64 twin and by properties.

Their means lie near the origin, where float32 holds them; the camera is up to 1e7 units away, where float32 steps by a
whole unit. In the wrong order images are off by 1e-2 to 0.5 of full scale. In the right one they are off by at most
1e-6 and gradients by at most 1e-5, as at any distance, so the tolerances are those of `test_rasterizer.py`.
"""

from __future__ import annotations

import math
import os
from dataclasses import replace

import numpy as np
import pytest
import torch
from builders import (
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

MOTIONS = ("full", "separable", "static")
COUNT = 20
WIDTH, HEIGHT = 40, 32
IMAGE_TOLERANCE, GRADIENT_TOLERANCE = 3e-5, 1e-4
FLOW_SCALE = 1.0  # pixels: flow is a difference of two places on the screen, which float32 holds to 1e-6 of the image


def camera_at(distance: float, rotated: bool, focal: float) -> Camera:
    """So far from the origin and looking at it; rotated: no axis of the world is its own."""
    if rotated:
        direction = np.array([0.3, -0.5, -0.8])
        return camera_looking_at(direction / np.linalg.norm(direction) * distance, WIDTH, HEIGHT, focal)
    pose = np.eye(4)
    pose[2, 3] = distance
    return Camera(WIDTH, HEIGHT, focal, focal * 1.1, WIDTH / 2, HEIGHT / 2, pose)


def one_behind_the_other(
    camera: Camera, motion: str, gap: float, unit: float, logit: float, count: int = COUNT, aside: float = 0.0
) -> Gaussians:
    """Rows in random order, `gap` world units apart along the viewing axis about the origin, sizes of about `unit`, up
    to `aside` off the axis. They hardly move, so that the order is that of the means."""
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


def check_against_twin(gaussians: Gaussians, request: Request, isa: str | None = None) -> None:
    """Images and gradients, where the image is smooth; no Gaussian is left out. isa: None for what RASTERIZER_ISA names,
    else the best there is."""
    smooth = smooth_pixels(gaussians, request)
    assert smooth.float().mean() > 0.9
    weights = output_weights(request, smooth, generator(9))
    expected, _ = render_and_gradients(reference.rasterize, gaussians, request, weights)
    scale = {
        name: max(FLOW_SCALE if name == "flow" else 1e-3, getattr(expected, name).abs().max().item())
        for name in request.outputs
    }
    weights = {name: weight / scale[name] for name, weight in weights.items()}  # every output counts alike
    _, truth = render_and_gradients(reference.rasterize, gaussians, request, weights)
    isa = isa or os.environ.get(ISA_VARIABLE) or available_isas()[0]
    images, gradients = images_and_gradients(isa, 1, gaussians.to(torch.float32), request, weights)
    for name, image in images.items():
        error = ((image - getattr(expected, name)).abs() * smooth).max().item()
        assert error <= IMAGE_TOLERANCE * scale[name], f"{name}: {error} of {scale[name]}"
    for name, exact in truth.items():
        error, largest = (gradients[name] - exact).abs().max().item(), exact.abs().max().item()
        assert error <= GRADIENT_TOLERANCE * largest, f"{name}: {error} of {largest}"


# ---- Against the twin --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("distance", "gap"), [(1e4, 5e-3), (1e4, 1e-4), (1e5, 5e-3), (1e6, 5e-3), (1e6, 1e-5), (1e7, 5e-3)]
)
@pytest.mark.parametrize("rotated", [False, True], ids=["along_axes", "rotated"])
@pytest.mark.parametrize("motion", MOTIONS)
def test_wide_gaussians_that_touch(motion: str, rotated: bool, distance: float, gap: float):
    """As large as they look, and transparent enough for the last to be seen."""
    camera = camera_at(distance, rotated, focal=40.0)
    gaussians = one_behind_the_other(camera, motion, gap, 0.1 * distance, logit=-1.0)
    if motion == "full":  # what is so large moves by more than the gap: let it stand
        gaussians = replace(gaussians, quat_right=gaussians.quat_left * torch.tensor([1, -1, -1, -1]))
    check_against_twin(gaussians, request_for(camera, motion))


@pytest.mark.parametrize("distance", [1e4, 1e5, 1e6, 1e7])
@pytest.mark.parametrize("rotated", [False, True], ids=["along_axes", "rotated"])
@pytest.mark.parametrize("motion", MOTIONS)
def test_small_ones_through_a_telephoto_lens(motion: str, rotated: bool, distance: float):
    """A unit is 8 pixels: float32's word for a place 1e7 units away is then 8 pixels wrong too."""
    camera = camera_at(distance, rotated, focal=8 * distance)
    gaussians = one_behind_the_other(camera, motion, 5e-3, 1.0, logit=0.0, aside=1.0)
    check_against_twin(gaussians, request_for(camera, motion))


@pytest.mark.parametrize("isa", available_isas())
@pytest.mark.parametrize("motion", MOTIONS)
def test_every_instruction_set_of_this_machine(motion: str, isa: str):
    camera = camera_at(1e6, True, focal=8e6)
    gaussians = one_behind_the_other(camera, motion, 5e-3, 1.0, logit=0.0, aside=1.0)
    check_against_twin(gaussians, request_for(camera, motion), isa)


@pytest.mark.parametrize("logit", [-3.0, 0.0, 3.0])
def test_opacities_from_faint_to_opaque(logit: float):
    camera = camera_at(1e6, True, focal=8e6)
    gaussians = one_behind_the_other(camera, "separable", 5e-3, 1.0, logit, aside=1.5)
    check_against_twin(gaussians, request_for(camera, "separable"))


def test_near_and_far_ones_in_one_view():
    """Every other one stands 3 units before a camera that is 2²⁰ units from the origin, where float32 holds eighths."""
    camera = camera_at(2.0**20, False, focal=40.0)
    gaussians = one_behind_the_other(camera, "static", 5e-3, 1e5, logit=-1.0)
    gaussians.mean[::2, 2] = torch.arange(COUNT // 2) / 8 + 3 - 2.0**20
    gaussians.log_scale[::2] -= math.log(1e5)
    check_against_twin(gaussians, request_for(camera, "static"))


# ---- Properties --------------------------------------------------------------------------------------------


def many_ties(camera: Camera) -> Gaussians:
    """More than two chunks of 1024, all within 24 of float32's steps of depth, a hundred exactly coincident."""
    gaussians = one_behind_the_other(camera, "separable", 5e-4, 1e5, logit=-6.0, count=3000)
    for name in ("mean", "log_scale", "quat_left"):
        getattr(gaussians, name)[1000:1100] = getattr(gaussians, name)[1000]
    return gaussians


@pytest.mark.parametrize("isa", available_isas())
def test_threads_change_no_bit(isa: str):
    camera = camera_at(1e6, True, focal=40.0)
    gaussians, request = many_ties(camera).to(torch.float32), color_request(camera)
    weights = {"color": torch.randn((3, HEIGHT, WIDTH), generator=generator(3))}
    one, *others = (images_and_gradients(isa, threads, gaussians, request, weights) for threads in (1, 2, 3))
    for other in others:
        for a, b in zip(one, other, strict=True):
            assert all(same_bits(a[name], b[name]) for name in a)


def test_the_order_of_the_rows_does_not_matter():
    """Nothing but depth orders far Gaussians, so shuffled rows give the same bits; nearer by ids order what ties."""
    for distance, independent in ((1e6, True), (4.0, False)):
        camera = camera_at(distance, True, focal=40.0)
        gap = 5e-3 if independent else 1e-8
        gaussians = one_behind_the_other(camera, "separable", gap, 0.1 * distance, logit=0.0)
        shuffled = Gaussians(
            **{
                "quat_right": None,
                **{name: tensor.flip(0).contiguous() for name, tensor in gaussians.tensors().items()},
            }
        )
        request = color_request(camera)
        assert torch.equal(color_of(gaussians, request), color_of(shuffled, request)) is independent


def test_coincident_ones_keep_the_order_of_their_rows():
    camera = camera_at(1e6, True, focal=40.0)
    gaussians = one_behind_the_other(camera, "separable", 0.0, 1e5, logit=0.0)
    check_against_twin(gaussians, request_for(camera, "separable"))


# ---- Where it begins ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("near", [0.2, 1.0])
@pytest.mark.parametrize(
    ("near_planes", "far"),
    [(20, False), (5000, False), (0.99 * FAR_NEAR_PLANES, False), (1.01 * FAR_NEAR_PLANES, True)],
)
def test_nearer_ones_that_tie_in_float32_stay_ordered_by_their_rows(near_planes: float, far: bool, near: float):
    """Gaps that float32 loses at that distance change no bit there; beyond, they say what lies in front."""
    distance = near_planes * near
    camera = camera_at(distance, False, focal=40.0)
    gaussians = one_behind_the_other(camera, "static", 1e-10 * distance, 0.1 * distance, logit=0.0)
    level = replace(gaussians, mean=gaussians.mean * torch.tensor([1.0, 1, 0]))
    request = color_request(camera, near=near)
    assert torch.equal(color_of(gaussians, request), color_of(level, request)) is not far
    truth = reference.rasterize(gaussians, camera, time=0.45, background=request.background, near=near).color
    assert ((color_of(gaussians, request) - truth).abs().max() < 1e-5).item() is far


def test_a_near_plane_at_the_camera_makes_all_of_them_far():
    camera = camera_at(4.0, True, focal=40.0)
    gaussians = one_behind_the_other(camera, "full", 1e-9, 0.4, logit=0.0)
    gaussians = replace(gaussians, quat_right=gaussians.quat_left * torch.tensor([1, -1, -1, -1]))
    check_against_twin(gaussians, request_for(camera, "full", near=0.0))
