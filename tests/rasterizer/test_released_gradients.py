"""What `released_gradients` are, by definition; test_kernel_vs_reference.py compares kernel and reference under them.

All in float64 by the reference implementation, so that 1e-12 of a tensor's largest gradient is rounding.
"""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from builders import generator, make_request, output_weights, random_gaussians, render_and_gradients
from torch import Tensor

from rasterizer import Gaussians, Request
from rasterizer.reference import render as reference
from rasterizer.reference.sh import sh_basis
from rasterizer.request import RELEASED_GRADIENTS


def of(gaussians: Gaussians, request: Request) -> tuple[Tensor, dict[str, Tensor]]:
    """The image, and the gradients for one fixed ∂L/∂image."""
    everywhere = torch.ones(request.camera.height, request.camera.width, dtype=torch.bool)
    weights = output_weights(request, everywhere, generator(5))
    out, found = render_and_gradients(reference.rasterize, gaussians, request, weights)
    assert out.color is not None
    return out.color.detach(), found


@pytest.fixture(scope="module")
def gaussians() -> Gaussians:
    return random_gaussians(40, "full", generator(4))


@pytest.fixture(scope="module")
def exact(gaussians: Gaussians) -> tuple[Tensor, dict[str, Tensor]]:
    return of(gaussians, make_request())


@pytest.mark.parametrize("name", RELEASED_GRADIENTS)
def test_images_and_the_gradients_of_opacities_are_the_exact_ones(gaussians, exact, name: str):
    image, found = of(gaussians, make_request(released_gradients=(name,)))
    assert torch.equal(image, exact[0])
    assert torch.equal(found["opacity_logit"], exact[1]["opacity_logit"])


def test_detached_gradients_are_those_of_constant_colours(gaussians, exact):
    """Gaussians whose constant colours are what the others show in this view: positions and times cannot change them.
    The authors' Python path passes such colours to its rasterizer."""
    request = make_request()
    shown = reference.colors(gaussians, reference.slice_of(gaussians, request), request)
    constant = ((shown - 0.5) / sh_basis(gaussians.mean[:, :3], 0))[:, None]
    image, truth = of(replace(gaussians, sh=constant), request)
    torch.testing.assert_close(image, exact[0], rtol=0, atol=1e-12)
    _, found = of(gaussians, replace(request, released_gradients=("detached",)))
    for name in ("mean", "log_scale", "quat_left", "quat_right", "opacity_logit"):
        torch.testing.assert_close(found[name], truth[name], rtol=0, atol=1e-12 * truth[name].abs().max().item())
    assert torch.equal(found["sh"], exact[1]["sh"])
    assert (found["mean"] - exact[1]["mean"]).abs().max() > 0.01 * exact[1]["mean"].abs().max()


def test_untrained_coefficients_are_those_that_vary_with_time(gaussians, exact):
    _, found = of(gaussians, make_request(released_gradients=("untrained",)))
    assert not found["sh"][:, 16:].any() and exact[1]["sh"][:, 16:].any()
    assert torch.equal(found["sh"][:, :16], exact[1]["sh"][:, :16])
    assert torch.equal(found["mean"], exact[1]["mean"])


@pytest.mark.parametrize("degree", [0, 1, 3])
def test_the_wrong_line_repeats_the_gradient_of_the_constant(gaussians, exact, degree: int):
    """Coefficient 1 alone, from degree 1 on; of the Fourier orders it is right."""
    _, truth = of(gaussians, make_request(sh_degree=degree))
    _, found = of(gaussians, make_request(sh_degree=degree, released_gradients=("wrong_line",)))
    others = torch.arange(48) != 1
    torch.testing.assert_close(found["sh"][:, others], truth["sh"][:, others], rtol=0, atol=1e-15)
    if degree == 0:
        assert not found["sh"][:, 1].any()
    else:
        scale = truth["sh"][:, 0].abs().max().item()
        torch.testing.assert_close(found["sh"][:, 1], truth["sh"][:, 0], rtol=0, atol=1e-12 * scale)
    assert torch.equal(found["mean"], truth["mean"])


def test_an_unknown_name_is_refused():
    with pytest.raises(
        ValueError, match="released_gradients must be among detached, untrained, wrong_line, got 'fixed'"
    ):
        make_request(released_gradients=("fixed",))
