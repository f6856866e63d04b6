"""A model before its environment: composed as the float64 twin composes it, with the gradient of that."""

from __future__ import annotations

import pytest
import torch
from builders import generator, off_centre_camera, random_gaussians
from builders import render as render_with
from test_environment import naive_look_up
from torch import Tensor

from pipeline.model.environment_map import EnvironmentMap
from pipeline.model.model import Model
from pipeline.model.render import backward, render, render_image
from rasterizer import Gaussians, Gradients, Rasterizer, Request
from rasterizer.reference import rasterize as reference
from rasterizer.reference.discontinuities import away_from_discontinuities, smooth_pixels

HEIGHT = 10
REQUEST = Request(off_centre_camera(), time=0.4, background=(0.2, 0.9, 0.1), outputs=("color", "alpha"))


def example() -> tuple[Gaussians, Tensor, Tensor]:
    """Gaussians (float64), a picture (3, h, 2h) float64 and ∂L/∂image (3, H, W), zero where the image jumps."""
    gaussians = away_from_discontinuities(
        random_gaussians(60, "full", generator(0), opacity_logit=(-2.0, 1.0)), REQUEST
    )
    picture = torch.rand(3, HEIGHT, 2 * HEIGHT, generator=generator(1)).double()
    weights = torch.randn(3, 37, 45, generator=generator(2), dtype=torch.float64)
    return gaussians, picture, weights * smooth_pixels(gaussians, REQUEST)


def model_of(gaussians: Gaussians, picture: Tensor | None) -> Model:
    model = Model.from_gaussians(gaussians.to(torch.float32))
    model.environment_map = None if picture is None else EnvironmentMap(picture.to(torch.float32))
    return model


def true_image(gaussians: Gaussians, behind: Tensor) -> Tensor:
    """(3, H, W) float64. behind: (3, H, W)."""
    black = Request(REQUEST.camera, REQUEST.time, outputs=("color", "alpha"))
    out = render_with(reference, gaussians, black)
    return out.color + (1 - out.alpha) * behind


@pytest.mark.parametrize("differentiable", [True, False])
def test_without_an_environment_it_is_the_rasterizers_image_bit_for_bit(differentiable: bool) -> None:
    model, frame = model_of(example()[0], None), Rasterizer(threads=1)
    expected = frame.render(model.gaussians(), REQUEST).color
    assert torch.equal(render(frame, model, REQUEST, differentiable).image, expected)
    assert torch.equal(render_image(frame, model, REQUEST), expected)


def test_the_image_is_the_gaussians_before_the_environment() -> None:
    gaussians, picture, weights = example()
    found = render_image(Rasterizer(threads=1), model_of(gaussians, picture), REQUEST)
    expected = true_image(gaussians, naive_look_up(picture, REQUEST.camera))
    smooth = (weights != 0).all(0)
    assert smooth.float().mean() > 0.5
    # 1e-5 for the look-up (test_environment), and as much for float32 blending of dozens of Gaussians
    torch.testing.assert_close(found.double()[:, smooth], expected[:, smooth], rtol=0, atol=2e-5)


def test_its_gradient_by_finite_differences_of_the_truth() -> None:
    """Along a random direction for each field and for the environment, in float64."""
    gaussians, picture, weights = example()
    model, frame = model_of(gaussians, picture), Rasterizer(threads=1)
    gradients, d_environment = Gradients.zeros_like(model.gaussians()), torch.zeros(3, HEIGHT, 2 * HEIGHT)
    rendered = render(frame, model, REQUEST)
    backward(frame, model, rendered, weights.to(torch.float32), gradients, d_environment)
    found = {**gradients.dense(), "sh": gradients.sh(), "environment": d_environment}

    tensors = {**gaussians.tensors(), "environment": picture}
    behind = naive_look_up(picture, REQUEST.camera)
    step = 1e-6  # the next jump is 1e-3 away
    for name, gradient in found.items():
        direction = torch.randn(tensors[name].shape, generator=generator(3), dtype=torch.float64)
        sides = []
        for sign in (1, -1):
            moved = {**tensors, name: tensors[name] + sign * step * direction}
            back = naive_look_up(moved.pop("environment"), REQUEST.camera) if name == "environment" else behind
            moved.pop("environment", None)
            sides.append((true_image(Gaussians(**moved), back) * weights).sum().item())
        products = gradient.double() * direction
        # Float32 gradients: found up to 4e-6 of the size of what is summed
        size = products.square().sum().sqrt().item()
        assert (sides[0] - sides[1]) / (2 * step) == pytest.approx(products.sum().item(), abs=5e-5 * size), name
        assert size > 0.1, name


def test_an_environment_that_is_not_trained_changes_no_other_gradient() -> None:
    gaussians, picture, weights = example()
    model, frame, found = model_of(gaussians, picture), Rasterizer(threads=1), []
    for d_environment in (torch.zeros(3, HEIGHT, 2 * HEIGHT), None):
        found.append(Gradients.zeros_like(model.gaussians()))
        backward(frame, model, render(frame, model, REQUEST), weights.to(torch.float32), found[-1], d_environment)
    for name, gradient in found[0].dense().items():
        assert torch.equal(gradient, found[1].dense()[name]) and gradient.any(), name
