"""Rendering with an environment map: image and gradient against the float64 reference implementation."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from builders import generator, off_centre_camera, random_gaussians
from builders import render as render_with
from test_environment_map import naive_sample
from torch import Tensor

from pipeline.model.environment_map import EnvironmentMap
from pipeline.model.model import Model
from pipeline.model.render import VIEWS_AT_ONCE, ImageGradient, backward, render, render_each, render_image
from rasterizer import Gaussians, Gradients, Rasterizer, Request
from rasterizer.reference import rasterize as reference
from rasterizer.reference.discontinuities import away_from_discontinuities, smooth_pixels

HEIGHT = 10
REQUEST = Request(off_centre_camera(), time=0.4, background=(0.2, 0.9, 0.1), outputs=("color", "alpha"))


def example() -> tuple[Gaussians, Tensor, Tensor]:
    """Gaussians (float64), an environment map (3, h, 2h) float64, and ∂L/∂image (3, H, W), zero at discontinuities."""
    gaussians = away_from_discontinuities(
        random_gaussians(60, "full", generator(0), opacity_logit=(-2.0, 1.0)), REQUEST
    )
    texels = torch.rand(3, HEIGHT, 2 * HEIGHT, generator=generator(1)).double()
    weights = torch.randn(3, 37, 45, generator=generator(2), dtype=torch.float64)
    return gaussians, texels, weights * smooth_pixels(gaussians, REQUEST)


def model_of(gaussians: Gaussians, texels: Tensor | None) -> Model:
    model = Model.from_gaussians(gaussians.to(torch.float32))
    model.environment_map = None if texels is None else EnvironmentMap(texels.to(torch.float32))
    return model


def reference_image(gaussians: Gaussians, colors: Tensor) -> Tensor:
    """(3, H, W) float64. colors: (3, H, W) of the environment map."""
    black = Request(REQUEST.camera, REQUEST.time, outputs=("color", "alpha"))
    out = render_with(reference, gaussians, black)
    return out.color + (1 - out.alpha) * colors


@pytest.mark.parametrize("differentiable", [True, False])
def test_without_an_environment_map_the_image_is_the_rasterizers(differentiable: bool) -> None:
    model, rasterizer = model_of(example()[0], None), Rasterizer(threads=1)
    expected = rasterizer.render(model.gaussians(), REQUEST).color
    assert torch.equal(render(rasterizer, model, REQUEST, differentiable).image, expected)
    assert torch.equal(render_image(rasterizer, model, REQUEST), expected)


@pytest.mark.parametrize("views", [0, 1, VIEWS_AT_ONCE + 1])
def test_views_rendered_together_have_the_bits_of_each_alone(views: int) -> None:
    """Images, and gradients by them: those of a view come before the next one's."""
    model, alone = model_of(example()[0], None), Rasterizer(threads=1)
    requests = [replace(REQUEST, time=0.1 * (1 + index)) for index in range(views)]
    seen = 0
    for request, (engine, rendered) in zip(requests, render_each("cpu", 1, model, requests), strict=True):
        found, expected = (Gradients.zeros_like(model.gaussians()) for _ in range(2))
        backward(engine, model, rendered, ImageGradient(image=rendered.image), found)
        single = render(alone, model, request)
        assert torch.equal(rendered.image, single.image)
        backward(alone, model, single, ImageGradient(image=single.image), expected)
        for name, tensor in expected.dense().items():
            assert torch.equal(found.dense()[name], tensor), name
        seen += 1
    assert seen == views


def test_the_image_is_composited_over_the_environment_map() -> None:
    gaussians, texels, weights = example()
    found = render_image(Rasterizer(threads=1), model_of(gaussians, texels), REQUEST)
    expected = reference_image(gaussians, naive_sample(texels, REQUEST.camera))
    smooth = (weights != 0).all(0)
    assert smooth.float().mean() > 0.5
    # 1e-5 for sampling (test_environment_map), and as much for float32 blending of dozens of Gaussians
    torch.testing.assert_close(found.double()[:, smooth], expected[:, smooth], rtol=0, atol=2e-5)


def test_the_gradient_equals_finite_differences_of_the_reference() -> None:
    """Along a random direction for each field and for the environment map, in float64."""
    gaussians, texels, weights = example()
    model, rasterizer = model_of(gaussians, texels), Rasterizer(threads=1)
    gradients, d_environment_map = Gradients.zeros_like(model.gaussians()), torch.zeros(3, HEIGHT, 2 * HEIGHT)
    rendered = render(rasterizer, model, REQUEST)
    backward(rasterizer, model, rendered, ImageGradient(image=weights.to(torch.float32)), gradients, d_environment_map)
    found = {**gradients.dense(), "sh": gradients.sh(), "environment_map": d_environment_map}

    tensors = {**gaussians.tensors(), "environment_map": texels}
    unchanged = naive_sample(texels, REQUEST.camera)
    step = 1e-6  # the next discontinuity is at least 1e-3 away
    for name, gradient in found.items():
        direction = torch.randn(tensors[name].shape, generator=generator(3), dtype=torch.float64)
        sides = []
        for sign in (1, -1):
            moved = {**tensors, name: tensors[name] + sign * step * direction}
            colors = (
                naive_sample(moved.pop("environment_map"), REQUEST.camera) if name == "environment_map" else unchanged
            )
            moved.pop("environment_map", None)
            sides.append((reference_image(Gaussians(**moved), colors) * weights).sum().item())
        products = gradient.double() * direction
        # float32 gradients; measured: up to 4e-6 of the norm of the summed terms
        size = products.square().sum().sqrt().item()
        assert (sides[0] - sides[1]) / (2 * step) == pytest.approx(products.sum().item(), abs=5e-5 * size), name
        assert size > 0.1, name


def test_other_gradients_do_not_depend_on_training_the_environment_map() -> None:
    gaussians, texels, weights = example()
    model, rasterizer, found = model_of(gaussians, texels), Rasterizer(threads=1), []
    for d_environment_map in (torch.zeros(3, HEIGHT, 2 * HEIGHT), None):
        found.append(Gradients.zeros_like(model.gaussians()))
        backward(
            rasterizer,
            model,
            render(rasterizer, model, REQUEST),
            ImageGradient(image=weights.to(torch.float32)),
            found[-1],
            d_environment_map,
        )
    for name, gradient in found[0].dense().items():
        assert torch.equal(gradient, found[1].dense()[name]) and gradient.any(), name
