"""The reference implementation's images and gradients: a naive renderer, invariances, finite differences, bad input.

`test_reference_equations.py` tests its equations one by one. All in float64, where correct formulas differ by rounding
alone.
"""

from __future__ import annotations

import math
import time
from dataclasses import replace

import numpy as np
import pytest
import torch
from builders import (
    MOTIONS,
    camera_looking_at,
    generator,
    off_centre_camera,
    output_weights,
    outputs_of,
    random_gaussians,
    render,
    render_and_gradients,
    rotated_world,
    uniform,
)

from rasterizer.camera import Camera
from rasterizer.covariance import scaled_axes
from rasterizer.gaussians import Gaussians
from rasterizer.reference import render as reference
from rasterizer.reference.discontinuities import away_from_discontinuities, smooth_pixels
from rasterizer.reference.sh import sh_basis
from rasterizer.request import OUTPUT_NAMES, Request

# ---- Whole images ------------------------------------------------------------------------------------------


def naive_splats(gaussians: Gaussians, request: Request) -> list[tuple]:
    """(depth, row, centre, inverse 2D covariance, opacity, features) of each Gaussian in view, nearest first."""
    camera, axes = request.camera, scaled_axes(gaussians).numpy()
    later_camera = request.flow_camera or camera
    sigma = axes @ axes.transpose(0, 2, 1)
    mean, k = gaussians.mean.numpy(), gaussians.sh.numpy()
    half_fov = [(camera.cx, camera.width - camera.cx, camera.fx), (camera.cy, camera.height - camera.cy, camera.fy)]

    def to_camera(p: np.ndarray, camera: Camera = camera) -> np.ndarray:
        return camera.world_to_cam[:3, :3] @ p + camera.world_to_cam[:3, 3]

    def to_pixel(p: np.ndarray, camera: Camera = camera) -> np.ndarray:
        return np.array([camera.fx * p[0] / p[2] + camera.cx, camera.fy * p[1] / p[2] + camera.cy])

    splats = []
    for n in range(len(gaussians)):
        elapsed = request.time - mean[n, 3]
        marginal = math.exp(-0.5 * elapsed**2 / sigma[n, 3, 3])
        velocity = sigma[n, :3, 3] / sigma[n, 3, 3]
        world = mean[n, :3] + velocity * elapsed
        point = to_camera(world)
        if marginal < 0.05 or point[2] <= request.near:
            continue
        u, v = (
            min(max(point[axis] / point[2], -1.3 * low / focal), 1.3 * high / focal)
            for axis, (low, high, focal) in enumerate(half_fov)
        )
        jacobian = np.array([[camera.fx, 0, -camera.fx * u], [0, camera.fy, -camera.fy * v]]) / point[2]
        covariance = sigma[n, :3, :3] - np.outer(sigma[n, :3, 3], sigma[n, :3, 3]) / sigma[n, 3, 3]
        jw = jacobian @ camera.world_to_cam[:3, :3]
        inverse = np.linalg.inv(jw @ covariance @ jw.T + 0.3 * np.eye(2))
        direction = world - camera.position
        basis = sh_basis(torch.from_numpy(direction / np.linalg.norm(direction))[None], gaussians.sh_degree)[0].numpy()
        color = 0.5
        for order in range(gaussians.fourier_order + 1):
            coefficients = k[n, order * len(basis) : (order + 1) * len(basis)]
            color = color + math.cos(2 * math.pi * order * elapsed / request.duration) * (basis @ coefficients)
        later = to_camera(world + velocity * request.flow_dt, later_camera)
        flow = to_pixel(later, later_camera) - to_pixel(point) if later[2] > request.near else np.zeros(2)
        opacity = marginal / (1 + math.exp(-gaussians.opacity_logit[n].item()))
        features = np.concatenate([np.maximum(color, 0), point[2:], flow, [mean[n, 3], sigma[n, 3, 3]]])
        splats.append((point[2], n, to_pixel(point), inverse, opacity, features))
    return sorted(splats, key=lambda splat: splat[:2])


def naive_image(gaussians: Gaussians, request: Request) -> dict[str, np.ndarray]:
    """The method as loops over pixels and Gaussians, in textbook algebra; only M and Y_lm are shared."""
    camera, splats = request.camera, naive_splats(gaussians, request)
    image, transmittance = np.zeros((8, camera.height, camera.width)), np.ones((camera.height, camera.width))
    ended = 0
    for row, column in np.ndindex(camera.height, camera.width):
        for _, _, center, inverse, opacity, features in splats:
            offset = np.array([column + 0.5, row + 0.5]) - center
            alpha = min(0.99, opacity * math.exp(-0.5 * offset @ inverse @ offset))
            if alpha < 1 / 255:
                continue
            if transmittance[row, column] * (1 - alpha) < 1e-4:
                ended += 1
                break
            image[:, row, column] += transmittance[row, column] * alpha * features
            transmittance[row, column] *= 1 - alpha
    assert ended > 10, "too few pixels end before their last Gaussian to test that rule"
    color = image[:3] + transmittance * np.reshape(request.background, (3, 1, 1))
    alpha = 1 - transmittance[None]
    return {"color": color, "alpha": alpha, "depth": image[3:4], "flow": image[4:6], "stats": image[6:8]}


@pytest.mark.parametrize("camera_moves", [False, True])
@pytest.mark.parametrize("motion", ["full", "separable"])
def test_images_match_the_naive_renderer(motion: str, camera_moves: bool):
    camera = camera_looking_at((0.6, -0.8, -3.0), width=21, height=17, focal=24.0, principal=(8.3, 10.1))
    request = Request(
        camera, time=0.4, duration=0.8, background=(0.2, 0.5, 0.9), outputs=OUTPUT_NAMES, flow_dt=0.1, near=2.5
    )  # near culls some Gaussians; high opacities end pixels early
    if camera_moves:
        request = replace(
            request,
            flow_camera=camera_looking_at((0.5, -0.7, -2.9), width=21, height=17, focal=25.0, principal=(8.0, 9.8)),
        )
    gaussians = random_gaussians(100, motion, generator(8), log_scale=(-2.0, -0.5), opacity_logit=(0.0, 8.0))
    out, expected = render(reference.rasterize, gaussians, request), naive_image(gaussians, request)
    for name in OUTPUT_NAMES:
        torch.testing.assert_close(getattr(out, name), torch.from_numpy(expected[name]), rtol=1e-9, atol=1e-9)


def test_blending_in_bands_of_rows_changes_nothing(monkeypatch: pytest.MonkeyPatch):
    gaussians, camera = random_gaussians(50, "full", generator(9)), off_centre_camera()
    whole = reference.rasterize(gaussians, camera, time=0.5).color
    monkeypatch.setattr("rasterizer.reference.blend.CHUNK_ELEMENTS", 1)
    torch.testing.assert_close(reference.rasterize(gaussians, camera, time=0.5).color, whole)


@pytest.mark.parametrize("motion", MOTIONS)
def test_rotating_the_world_with_the_camera_changes_nothing(motion: str):
    gaussians, camera = random_gaussians(50, motion, generator(10), sh_degree=0), off_centre_camera()
    rotated, rotated_camera = rotated_world(gaussians, camera, torch.tensor([0.3, -0.5, 0.7, 0.4], dtype=torch.float64))
    before = reference.rasterize(gaussians, camera, time=0.3, outputs=("color", "depth"))
    after = reference.rasterize(rotated, rotated_camera, time=0.3, outputs=("color", "depth"))
    torch.testing.assert_close(after.color, before.color, rtol=1e-9, atol=1e-9)
    torch.testing.assert_close(after.depth, before.depth, rtol=1e-9, atol=1e-9)


def test_a_4d_gaussian_without_motion_equals_the_static_one_at_any_time():
    static, camera = random_gaussians(50, "static", generator(11)), off_centre_camera()
    pad = lambda t, value: torch.cat([t, torch.full((50, 1), value, dtype=t.dtype)], dim=1)  # noqa: E731
    timed = replace(static, mean=pad(static.mean, 0.5), log_scale=pad(static.log_scale, math.log(1e6)))
    expected = reference.rasterize(static, camera).color
    for instant in (0.0, 0.5, 7.0):
        # p(t) = 1 - ½ (6.5 / 1e6)² is 1 to 2e-11
        torch.testing.assert_close(reference.rasterize(timed, camera, time=instant).color, expected, rtol=0, atol=1e-9)


def test_a_lower_sh_degree_or_fourier_order_ignores_the_other_coefficients():
    gaussians, camera = random_gaussians(30, "full", generator(12)), off_centre_camera()
    blocks = gaussians.sh.reshape(30, 3, 16, 3)
    for degree, order in ((0, 0), (1, 2), (3, 1)):
        kept = replace(gaussians, sh=blocks[:, : order + 1, : (degree + 1) ** 2].flatten(1, 2))
        limited = reference.rasterize(gaussians, camera, time=0.4, sh_degree=degree, fourier_order=order).color
        assert torch.equal(limited, reference.rasterize(kept, camera, time=0.4).color)


@pytest.mark.parametrize("motion", MOTIONS)
def test_a_view_without_gaussians_shows_the_background(motion: str):
    camera = off_centre_camera()
    behind = random_gaussians(5, motion, generator(13))
    behind.mean[:, :3] += 3 * torch.from_numpy(camera.position)
    expected = torch.tensor([0.1, 0.2, 0.3], dtype=torch.float64)[:, None, None].expand(3, 37, 45)
    for gaussians in (random_gaussians(0, motion, generator(14)), behind):
        out = reference.rasterize(gaussians, camera, background=(0.1, 0.2, 0.3), outputs=("color", "alpha"))
        assert torch.equal(out.color, expected)
        assert torch.equal(out.alpha, torch.zeros(1, 37, 45).double()) and out.depth is None


def test_only_requested_outputs_are_returned():
    out = reference.rasterize(random_gaussians(5, "full", generator(15)), off_centre_camera(), outputs=("depth",))
    assert out.depth.shape == (1, 37, 45) and out.color is out.alpha is out.flow is out.stats is None


# ---- Gradients ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("motion", MOTIONS)
def test_gradients_match_finite_differences(motion: str):
    """Every parameter, all outputs together.

    `away_from_discontinuities` and `smooth_pixels` keep the loss smooth within the step of 1e-6, which is far below
    their margins of 1e-3.
    """
    rng = generator(16)
    camera = camera_looking_at((0.6, -0.8, -3.0), width=14, height=11, focal=14.0, principal=(6.0, 6.2))
    request = Request(
        camera, time=0.45, duration=0.8, background=(0.3, 0.6, 0.1), outputs=outputs_of(motion), flow_dt=0.2
    )
    gaussians = random_gaussians(5, motion, rng, sh_degree=1, fourier_order=1, log_scale=(-2.0, -0.7))
    gaussians = away_from_discontinuities(gaussians, request)
    weights = output_weights(request, smooth_pixels(gaussians, request), rng)
    _, gradients = render_and_gradients(reference.rasterize, gaussians, request, weights)

    def loss(changed: Gaussians) -> float:
        out = render(reference.rasterize, changed, request)
        return sum((getattr(out, name) * weight).sum().item() for name, weight in weights.items())

    step = 1e-6
    for name, gradient in gradients.items():
        flat = gaussians.tensors()[name]
        expected = torch.zeros_like(gradient)
        for index in np.ndindex(*flat.shape):
            values = []
            for side in (step, -step):
                moved = flat.clone()
                moved[index] += side
                values.append(loss(Gaussians.from_tensors(gaussians.tensors() | {name: moved}, gaussians.span)))
            expected[index] = (values[0] - values[1]) / (2 * step)
        # Losses of about 100 round at 1e-14, so quotients at 1e-8; the truncation error is smaller.
        torch.testing.assert_close(gradient, expected, rtol=1e-5, atol=1e-6 * expected.abs().max().item())


def test_clamped_alpha_and_colour_have_no_gradient():
    camera = Camera(3, 3, 10.0, 10.0, 1.5, 1.5, np.eye(4))
    gaussians = Gaussians(
        torch.tensor([[0.0, 0, 2]]),
        torch.full((1, 3), 3.0),
        torch.tensor([[1.0, 0, 0, 0]]),
        None,
        torch.tensor([9.0]),
        torch.tensor([[[-9.0, 0, 9]]]),
    ).to(torch.float64)
    request = Request(camera)
    out, gradients = render_and_gradients(reference.rasterize, gaussians, request, {"color": torch.ones(3, 3, 3)})
    assert gradients["opacity_logit"].item() == 0 and gradients["sh"][0, 0, 0] == 0 and gradients["sh"][0, 0, 2] > 0
    assert (out.color[0] == 0).all()


# ---- Invalid input, speed ----------------------------------------------------------------------------------


def test_a_non_finite_parameter_is_named():
    for name in ("mean", "log_scale", "quat_left", "quat_right", "opacity_logit", "sh"):
        gaussians = random_gaussians(5, "full", generator(17))
        getattr(gaussians, name)[3] = math.nan
        with pytest.raises(ValueError, match=rf"^{name}\[3.*must be finite, got nan$"):
            reference.rasterize(gaussians, off_centre_camera())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"time": math.nan}, "time must be finite, got nan"),
        ({"duration": 0.0}, "duration must be finite and > 0, got 0.0"),
        ({"near": -1.0}, "near must be finite and >= 0, got -1.0"),
        ({"background": (0, 0)}, "background must be 3 numbers that float32 holds"),
        ({"outputs": ("colour",)}, "outputs must be among .* got 'colour'"),
        ({"outputs": ("flow",)}, "flow_dt must be a number up to 1e.30 for the output 'flow', got None"),
        ({"sh_degree": 4}, r"sh_degree must be in 0\.\.3, as stored, got 4"),
        ({"fourier_order": -1}, r"fourier_order must be in 0\.\.2, as stored, got -1"),
    ],
)
def test_invalid_arguments_are_named(arguments: dict, message: str):
    with pytest.raises(ValueError, match=message):
        reference.rasterize(random_gaussians(2, "full", generator(18)), off_centre_camera(), **arguments)


def test_a_static_model_has_no_temporal_statistics():
    with pytest.raises(ValueError, match="'stats'"):
        reference.rasterize(random_gaussians(2, "static", generator(19)), off_centre_camera(), outputs=("stats",))


def test_a_small_image_takes_less_than_five_seconds():
    gaussians = random_gaussians(200, "full", generator(20))
    weights = {"color": uniform((3, 48, 64), -1, 1, generator(21))}
    request = Request(camera_looking_at((0, 0, -3), width=64, height=48), time=0.5)
    start = time.process_time()
    render_and_gradients(reference.rasterize, gaussians, request, weights)
    assert time.process_time() - start < 5  # takes 0.2 s; far more would mean a wrong complexity
