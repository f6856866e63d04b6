"""The kernel without autograd, as training uses it: same numbers, same bits on any threads, errors."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from builders import generator, off_centre_camera, output_weights, outputs_of, random_gaussians, render_and_gradients
from torch import Tensor

from rasterizer import Gaussians, Gradients, Rasterizer, Request, ViewGradient, rasterize
from rasterizer.reference import render as reference
from rasterizer.reference.blend import blend
from rasterizer.reference.discontinuities import away_from_discontinuities, rows, smooth_pixels

MOTIONS = ("full", "separable", "static")


def request_for(motion: str, **changes) -> Request:
    return replace(
        Request(
            off_centre_camera(),
            time=0.45,
            duration=0.8,
            background=(0.3, 0.6, 0.1),
            outputs=outputs_of(motion),
            flow_dt=0.2,
        ),
        **changes,
    )


def image_gradients(request: Request, seed: int = 0) -> dict[str, Tensor]:
    everywhere = torch.ones(request.camera.height, request.camera.width)
    weights = output_weights(request, everywhere, generator(seed))
    return {f"d_{name}": weight.to(torch.float32) for name, weight in weights.items()}


def run_frame(
    gaussians: Gaussians, requests: list[Request], threads: int
) -> tuple[dict[str, Tensor], list[ViewGradient]]:
    """Images, summed gradients and compact ones of several views through one Frame, by name."""
    frame, gradients = Rasterizer(threads=threads), Gradients.zeros_like(gaussians)
    found, views = {}, []
    for number, request in enumerate(requests):
        out = frame.render(gaussians, request)
        found |= {f"{name}{number}": getattr(out, name) for name in request.outputs}
        views.append(frame.backward(gradients, **image_gradients(request, number)))
    return found | gradients.dense() | {"sh": gradients.sh(threads)}, views


@pytest.mark.parametrize("motion", MOTIONS)
def test_any_number_of_threads_gives_the_same_bits(motion: str):
    gaussians = random_gaussians(500, motion, generator(1)).to(torch.float32)
    requests = [request_for(motion), request_for(motion, time=0.6)]
    expected, expected_views = run_frame(gaussians, requests, threads=1)
    for threads in (2, 3):
        found, views = run_frame(gaussians, requests, threads)
        for name, tensor in expected.items():
            assert torch.equal(found[name], tensor), name
        for view, expected_view in zip(views, expected_views):
            assert all(
                torch.equal(getattr(view, name), getattr(expected_view, name))
                for name in ViewGradient.__dataclass_fields__
            )


@pytest.mark.parametrize("motion", MOTIONS)
def test_a_frame_and_autograd_give_the_same_bits(motion: str):
    gaussians, request = random_gaussians(60, motion, generator(2)).to(torch.float32), request_for(motion)
    weights = {name.removeprefix("d_"): weight for name, weight in image_gradients(request).items()}
    out, gradients = render_and_gradients(rasterize, gaussians, request, weights)
    found, _ = run_frame(gaussians, [request], threads=1)
    for name in request.outputs:
        assert torch.equal(getattr(out, name), found[f"{name}0"])
    for name, gradient in gradients.items():
        assert torch.equal(gradient, found[name]), name


def test_gradients_of_views_add_up():
    """A Frame used twice holds nothing over: the sum differs from its parts by rounding alone."""
    gaussians = random_gaussians(60, "full", generator(3)).to(torch.float32)
    requests = [request_for("full"), request_for("full", time=0.7, sh_degree=1, fourier_order=1)]
    both, _ = run_frame(gaussians, requests, threads=1)
    expected: dict[str, Tensor] = {}
    for number, request in enumerate(requests):
        gradients, frame = Gradients.zeros_like(gaussians), Rasterizer(threads=1)
        frame.render(gaussians, request)
        frame.backward(gradients, **image_gradients(request, number))
        for name, tensor in (gradients.dense() | {"sh": gradients.sh()}).items():
            expected[name] = expected.get(name, 0) + tensor
    for name, tensor in expected.items():
        torch.testing.assert_close(both[name], tensor, rtol=1e-5, atol=1e-6 * tensor.abs().max().item())


def test_zeroed_gradients_start_afresh():
    gaussians, request = random_gaussians(40, "full", generator(4)).to(torch.float32), request_for("full")
    frame, gradients = Rasterizer(threads=1), Gradients.zeros_like(gaussians)
    for _ in range(2):
        gradients.zero_()
        frame.render(gaussians, request)
        frame.backward(gradients, **image_gradients(request))
    once, _ = run_frame(gaussians, [request], threads=1)
    assert torch.equal(gradients.mean, once["mean"]) and torch.equal(gradients.sh(), once["sh"])


@pytest.mark.parametrize("motion", MOTIONS)
def test_what_a_view_says_of_its_gaussians(motion: str):
    """∂L/∂pixel position, ∂L/∂μt and radius of the visible ones, against the twin."""
    request = request_for(motion, outputs=("color",))
    gaussians = away_from_discontinuities(random_gaussians(60, motion, generator(5)), request)
    weights = output_weights(request, smooth_pixels(gaussians, request), generator(6))
    frame, gradients = Rasterizer(threads=1), Gradients.zeros_like(gaussians.to(torch.float32))
    frame.render(gaussians.to(torch.float32), request)
    view = frame.backward(gradients, d_color=weights["color"].to(torch.float32))

    splats = reference.make_splats(gaussians, request)
    center = splats.center.detach().requires_grad_()
    sums, transmittance = blend(replace(splats, center=center), request.camera)
    image = sums + transmittance * torch.tensor(request.background, dtype=torch.float64)[:, None, None]
    (d_center,) = torch.autograd.grad((image * weights["color"]).sum(), center)
    expected = torch.zeros(len(gaussians), 2, dtype=torch.float64).index_copy(0, splats.index, d_center)

    visible = view.visible.long()
    assert (visible[1:] > visible[:-1]).all() and set(visible.tolist()) <= set(splats.index.tolist())
    unseen = torch.ones(len(gaussians), dtype=torch.bool).index_fill(0, visible, False)
    assert not expected[unseen].any(), "a Gaussian with an effect is not among the visible"
    # 1e-4 of the largest: the tolerance of gradients everywhere
    torch.testing.assert_close(view.mean2d.double(), expected[visible], rtol=0, atol=1e-4 * expected.abs().max().item())
    if motion != "static":
        torch.testing.assert_close(view.mean_t, gradients.mean[visible, 3])
    lean, across, along = splats.ellipse.unbind(1)
    shear = -lean * along  # cxy
    covariance = torch.stack([across + lean**2 * along, shear, shear, along], dim=1).reshape(-1, 2, 2)
    radius = (
        torch.zeros(len(gaussians))
        .double()
        .index_copy(0, splats.index, 3 * torch.linalg.eigvalsh(covariance)[:, 1].sqrt())
    )
    torch.testing.assert_close(view.radius.double(), radius[visible], rtol=1e-3, atol=0)


def test_visible_and_alive_are_counted():
    gaussians, request = random_gaussians(200, "full", generator(7)), request_for("full")
    frame = Rasterizer(threads=1)
    frame.render(gaussians.to(torch.float32), request)
    marginal = reference.slice_in_time(away_from_discontinuities(gaussians, request), request.time).marginal
    # away_from_jumps leaves a few out, which may or may not be alive
    assert abs(frame.alive - (marginal >= 0.05).sum().item()) <= 200 - len(marginal)
    assert 0 < frame.visible <= frame.alive


# ---- Bad input ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["mean", "log_scale", "quat_left", "quat_right", "opacity_logit", "sh"])
def test_non_finite_parameters_are_named(name: str):
    for value in (math.nan, math.inf, -math.inf):
        gaussians = random_gaussians(9, "full", generator(8)).to(torch.float32)
        getattr(gaussians, name)[7] = value
        with pytest.raises(ValueError, match=rf"^{name}\[7.*must be finite, got {value}$"):
            rasterize(gaussians, off_centre_camera())


@pytest.mark.parametrize("entry", [rasterize, lambda g, camera: Rasterizer(threads=1).render(g, Request(camera))])
def test_wrong_types_and_layouts_are_named(entry):
    gaussians, camera = random_gaussians(9, "full", generator(9)), off_centre_camera()
    with pytest.raises(ValueError, match=r"^mean must be .*float32 \[9, 4\], got float64"):
        entry(gaussians, camera)
    gaussians = gaussians.to(torch.float32)
    spread = torch.empty(9, 8)[:, ::2].copy_(gaussians.quat_left)
    with pytest.raises(ValueError, match="^quat_left must be .*contiguous"):
        entry(replace(gaussians, quat_left=spread), camera)


def test_wrong_shapes_are_named():
    gaussians = random_gaussians(9, "full", generator(10)).to(torch.float32)
    for name, tensor, message in (
        ("mean", torch.zeros(9, 5), r"^mean must be \[N, 4\] or, static, \[N, 3\], got \[9, 5\]$"),
        ("log_scale", torch.zeros(9, 3), r"^log_scale must be \[9, 4\], got \[9, 3\]$"),
        ("quat_right", torch.zeros(8, 4), r"^quat_right must be \[9, 4\], got \[8, 4\]$"),
        ("opacity_logit", torch.zeros(9, 1), r"^opacity_logit must be \[9\], got \[9, 1\]$"),
        ("sh", torch.zeros(9, 5, 3), r"^sh must be \[9, .*got \[9, 5, 3\]$"),
    ):
        with pytest.raises(ValueError, match=message):
            replace(gaussians, **{name: tensor})


@pytest.mark.parametrize(
    "changes",
    [
        {"time": math.nan},
        {"time": math.inf},
        {"duration": 0.0},
        {"near": math.nan},
        {"background": (0, 0, math.nan)},
        {"outputs": ("colour",)},
        {"outputs": ("flow",), "flow_dt": None},
        {"sh_degree": 4},
        {"fourier_order": 3},
    ],
)
def test_bad_requests_are_named(changes: dict):
    name = next(reversed(changes))
    with pytest.raises(ValueError, match=f"^{name} must be "):
        rasterize(random_gaussians(3, "full", generator(11)).to(torch.float32), off_centre_camera(), **changes)


def test_backward_asks_for_what_was_rendered():
    gaussians = random_gaussians(9, "full", generator(12)).to(torch.float32)
    frame, gradients = Rasterizer(threads=1), Gradients.zeros_like(gaussians)
    with pytest.raises(RuntimeError, match="must follow Frame.render"):
        frame.backward(gradients)
    frame.render(gaussians, Request(off_centre_camera()))
    with pytest.raises(ValueError, match="d_depth: expected .depth. among the outputs"):
        frame.backward(gradients, d_depth=torch.zeros(1, 37, 45))
    with pytest.raises(ValueError, match=r"d_color must be float32 \[3, 37, 45\], got float32 \[3, 45, 37\]"):
        frame.backward(gradients, d_color=torch.zeros(3, 45, 37))
    with pytest.raises(ValueError, match="d_color must be float32"):
        frame.backward(gradients, d_color=torch.zeros(3, 37, 45, dtype=torch.float64))


def test_backward_refuses_an_image_that_was_changed_in_place():
    """It reads what render returned, so a changed image would give wrong gradients without a word."""
    gaussians, request = random_gaussians(80, "full", generator(14)).to(torch.float32), request_for("full")
    frame, gradients = Rasterizer(threads=1), Gradients.zeros_like(gaussians)
    image = frame.render(gaussians, request).color
    frame.backward(gradients, **image_gradients(request))
    image.clamp_(0.0, 0.5)
    with pytest.raises(RuntimeError, match="reads the rendered color, which was changed in place"):
        frame.backward(gradients, **image_gradients(request))


def test_rows_that_are_not_in_view_get_no_gradient():
    gaussians, request = random_gaussians(80, "full", generator(13)).to(torch.float32), request_for("full")
    found, (view,) = run_frame(gaussians, [request], threads=2)
    hidden = torch.ones(80, dtype=torch.bool).index_fill(0, view.visible.long(), False)
    assert hidden.any()
    for name, tensor in rows(gaussians, hidden.nonzero().squeeze(1)).tensors().items():
        assert tensor.numel() and not found[name][hidden].any(), name


@pytest.mark.parametrize("motion", MOTIONS)
def test_a_view_for_looking_at_only_is_that_image_and_has_no_backward(motion: str):
    gaussians, request = random_gaussians(80, motion, generator(9)).to(torch.float32), request_for(motion)
    frame = Rasterizer(threads=1)
    images = [frame.render(gaussians, request, differentiable=wanted) for wanted in (True, False)]
    for name in request.outputs:
        # compiled apart, so a colour's sum may be rounded elsewhere: a few units in the last place
        torch.testing.assert_close(getattr(images[0], name), getattr(images[1], name), rtol=0, atol=5e-7)
    with pytest.raises(RuntimeError, match="differentiable=True"):
        frame.backward(Gradients.zeros_like(gaussians), **image_gradients(request))
