"""`Rasterizer`, the kernel without autograd: the same bits as autograd and with any threads, view gradients."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from builders import (
    MOTIONS,
    generator,
    make_request,
    output_weights,
    outputs_of,
    random_gaussians,
    render_and_gradients,
)
from torch import Tensor

from rasterizer import Gaussians, Gradients, Rasterizer, Request, ViewGradient, rasterize
from rasterizer.reference import render as reference
from rasterizer.reference.blend import blend
from rasterizer.reference.discontinuities import away_from_discontinuities, smooth_pixels


def request_for(motion: str, **changes) -> Request:
    """All outputs of the model, unless changed."""
    return make_request(**{"outputs": outputs_of(motion), "flow_dt": 0.2, **changes})


def image_gradients(request: Request, seed: int = 0) -> dict[str, Tensor]:
    everywhere = torch.ones(request.camera.height, request.camera.width)
    weights = output_weights(request, everywhere, generator(seed))
    return {f"d_{name}": weight.to(torch.float32) for name, weight in weights.items()}


def render_and_backward(
    gaussians: Gaussians, requests: list[Request], threads: int
) -> tuple[dict[str, Tensor], list[ViewGradient]]:
    """Images and summed gradients by name, and the view gradients, of several views with one Rasterizer."""
    rasterizer, gradients = Rasterizer(threads=threads), Gradients.zeros_like(gaussians)
    found, views = {}, []
    for number, request in enumerate(requests):
        out = rasterizer.render(gaussians, request)
        found |= {f"{name}{number}": getattr(out, name) for name in request.outputs}
        views.append(rasterizer.backward(gradients, **image_gradients(request, number)))
    return found | gradients.dense() | {"sh": gradients.sh(threads)}, views


@pytest.mark.parametrize("motion", MOTIONS)
def test_any_number_of_threads_gives_the_same_bits(motion: str):
    gaussians = random_gaussians(500, motion, generator(1)).to(torch.float32)
    requests = [request_for(motion), request_for(motion, time=0.6)]
    expected, expected_views = render_and_backward(gaussians, requests, threads=1)
    for threads in (2, 3, 64):
        found, views = render_and_backward(gaussians, requests, threads)
        for name, tensor in expected.items():
            assert torch.equal(found[name], tensor), name
        for view, expected_view in zip(views, expected_views):
            assert all(
                torch.equal(getattr(view, name), getattr(expected_view, name))
                for name in ViewGradient.__dataclass_fields__
            )


@pytest.mark.parametrize("motion", MOTIONS)
def test_rasterizer_and_autograd_give_the_same_bits(motion: str):
    gaussians, request = random_gaussians(60, motion, generator(2)).to(torch.float32), request_for(motion)
    weights = {name.removeprefix("d_"): weight for name, weight in image_gradients(request).items()}
    out, gradients = render_and_gradients(rasterize, gaussians, request, weights)
    found, _ = render_and_backward(gaussians, [request], threads=1)
    for name in request.outputs:
        assert torch.equal(getattr(out, name), found[f"{name}0"])
    for name, gradient in gradients.items():
        assert torch.equal(gradient, found[name]), name


@pytest.mark.parametrize("motion", MOTIONS)
def test_views_rendered_together_have_the_bits_of_each_alone(motion: str):
    """Views of other sizes, times, orders and outputs, over several chunks of Gaussians."""
    gaussians = random_gaussians(2500, motion, generator(14)).to(torch.float32)
    wide = replace(make_request().camera, width=70)
    order = min(1, gaussians.fourier_order)
    requests = [
        request_for(motion),
        request_for(motion, time=0.6, outputs=("color",)),
        request_for(motion, time=0.1, camera=wide, sh_degree=1, fourier_order=order),
    ]
    expected = []
    for request in requests:
        rasterizer, gradients = Rasterizer(threads=1), Gradients.zeros_like(gaussians)
        out = rasterizer.render(gaussians, request)
        rasterizer.backward(gradients, **image_gradients(request))
        expected.append((out, gradients, rasterizer.alive, rasterizer.visible))
    for threads in (1, 3):
        rasterizers = [Rasterizer(threads) for _ in requests]
        together = Rasterizer.render_batch(rasterizers, gaussians, requests)
        for rasterizer, request, out, one in zip(rasterizers, requests, together, expected, strict=True):
            gradients = Gradients.zeros_like(gaussians)
            rasterizer.backward(gradients, **image_gradients(request))
            assert (rasterizer.alive, rasterizer.visible) == one[2:] and rasterizer.visible > 0
            assert all(torch.equal(getattr(out, name), getattr(one[0], name)) for name in request.outputs)
            assert all(torch.equal(tensor, one[1].dense()[name]) for name, tensor in gradients.dense().items())
            assert torch.equal(gradients.sh(), one[1].sh())


def test_gradients_of_a_batch_are_the_sum_over_its_views():
    """A Rasterizer carries nothing over to its next view: the sums differ by rounding alone."""
    gaussians = random_gaussians(60, "full", generator(3)).to(torch.float32)
    requests = [request_for("full"), request_for("full", time=0.7, sh_degree=1, fourier_order=1)]
    both, _ = render_and_backward(gaussians, requests, threads=1)
    expected: dict[str, Tensor] = {}
    for number, request in enumerate(requests):
        gradients, rasterizer = Gradients.zeros_like(gaussians), Rasterizer(threads=1)
        rasterizer.render(gaussians, request)
        rasterizer.backward(gradients, **image_gradients(request, number))
        for name, tensor in (gradients.dense() | {"sh": gradients.sh()}).items():
            expected[name] = expected.get(name, 0) + tensor
    for name, tensor in expected.items():
        torch.testing.assert_close(both[name], tensor, rtol=1e-5, atol=1e-6 * tensor.abs().max().item())


def test_zero_resets_the_gradients():
    gaussians, request = random_gaussians(40, "full", generator(4)).to(torch.float32), request_for("full")
    rasterizer, gradients = Rasterizer(threads=1), Gradients.zeros_like(gaussians)
    for _ in range(2):
        gradients.zero_()
        rasterizer.render(gaussians, request)
        rasterizer.backward(gradients, **image_gradients(request))
    once, _ = render_and_backward(gaussians, [request], threads=1)
    assert torch.equal(gradients.mean, once["mean"]) and torch.equal(gradients.sh(), once["sh"])


@pytest.mark.parametrize("motion", MOTIONS)
def test_view_gradient_matches_the_reference_implementation(motion: str):
    """∂L/∂(projected mean), ∂L/∂μt, radius of the visible Gaussians."""
    request = request_for(motion, outputs=("color",))
    gaussians = away_from_discontinuities(random_gaussians(60, motion, generator(5)), request)
    weights = output_weights(request, smooth_pixels(gaussians, request), generator(6))
    rasterizer, gradients = Rasterizer(threads=1), Gradients.zeros_like(gaussians.to(torch.float32))
    rasterizer.render(gaussians.to(torch.float32), request)
    view = rasterizer.backward(gradients, d_color=weights["color"].to(torch.float32))

    splats = reference.make_splats(gaussians, request)
    center = splats.center.detach().requires_grad_()
    sums, transmittance = blend(replace(splats, center=center), request.camera)
    image = sums + transmittance * torch.tensor(request.background, dtype=torch.float64)[:, None, None]
    (d_center,) = torch.autograd.grad((image * weights["color"]).sum(), center)
    expected = torch.zeros(len(gaussians), 2, dtype=torch.float64).index_copy(0, splats.index, d_center)

    visible = view.visible.long()
    assert (visible[1:] > visible[:-1]).all() and set(visible.tolist()) <= set(splats.index.tolist())
    invisible = torch.ones(len(gaussians), dtype=torch.bool).index_fill(0, visible, False)
    assert not expected[invisible].any(), "a Gaussian with a gradient is not among the visible ones"
    # 1e-4 of the largest: the tolerance of gradients in test_kernel_vs_reference.py
    torch.testing.assert_close(view.mean2d.double(), expected[visible], rtol=0, atol=1e-4 * expected.abs().max().item())
    if motion != "static":
        torch.testing.assert_close(view.mean_t, gradients.mean[visible, 3])
    shear, variance_x, cyy = splats.ellipse.unbind(1)
    cxx, cxy = variance_x + shear**2 * cyy, -shear * cyy
    largest_variance = torch.linalg.eigvalsh(torch.stack([cxx, cxy, cxy, cyy], dim=1).reshape(-1, 2, 2))[:, 1]
    radius = torch.zeros(len(gaussians)).double().index_copy(0, splats.index, 3 * largest_variance.sqrt())
    torch.testing.assert_close(view.radius.double(), radius[visible], rtol=1e-3, atol=0)


def test_counts_of_visible_and_alive_gaussians():
    gaussians, request = random_gaussians(200, "full", generator(7)), request_for("full")
    rasterizer = Rasterizer(threads=1)
    rasterizer.render(gaussians.to(torch.float32), request)
    marginal = reference.slice_in_time(away_from_discontinuities(gaussians, request), request.time).marginal
    # away_from_discontinuities drops a few, which may or may not be alive
    assert abs(rasterizer.alive - (marginal >= 0.05).sum().item()) <= 200 - len(marginal)
    assert 0 < rasterizer.visible <= rasterizer.alive


def test_a_negated_image_gradient_counts_with_its_sign():
    gaussians, request = random_gaussians(80, "full", generator(12)).to(torch.float32), request_for("full")
    rasterizer, d_color = Rasterizer(threads=1), image_gradients(request)["d_color"]
    rasterizer.render(gaussians, request)
    found, expected = Gradients.zeros_like(gaussians), Gradients.zeros_like(gaussians)
    rasterizer.backward(found, d_color=torch._neg_view(d_color))
    rasterizer.backward(expected, d_color=-d_color)
    assert expected.mean.any() and torch.equal(found.mean, expected.mean)


def test_invisible_gaussians_get_no_gradient():
    gaussians, request = random_gaussians(80, "full", generator(13)).to(torch.float32), request_for("full")
    found, (view,) = render_and_backward(gaussians, [request], threads=2)
    hidden = torch.ones(80, dtype=torch.bool).index_fill(0, view.visible.long(), False)
    assert hidden.any()
    for name in gaussians.tensors():
        assert not found[name][hidden].any(), name


@pytest.mark.parametrize("motion", MOTIONS)
def test_rendering_without_gradients_gives_the_same_image_and_no_backward(motion: str):
    gaussians, request = random_gaussians(80, motion, generator(9)).to(torch.float32), request_for(motion)
    rasterizer = Rasterizer(threads=1)
    images = [rasterizer.render(gaussians, request, differentiable=value) for value in (True, False)]
    for name in request.outputs:
        # Separate template instances, whose colour sums may round differently: a few units in the last place.
        torch.testing.assert_close(getattr(images[0], name), getattr(images[1], name), rtol=0, atol=5e-7)
    with pytest.raises(RuntimeError, match="differentiable=True"):
        rasterizer.backward(Gradients.zeros_like(gaussians), **image_gradients(request))
