"""Renders a view of a model: the Gaussians, composited over its environment map where it has one.

    image = colour + (1 - alpha) · environment_map(direction of the pixel)

Training and evaluation both render through here. Without an environment map the image is the rasterizer's, bit for bit.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from torch import Tensor

from pipeline.model.model import Model
from rasterizer import Gradients, Rasterizer, RenderOutput, Request, ViewGradient


@dataclass(frozen=True)
class Composite:
    """What an image over an environment map was composited from; its backward pass needs it."""

    alpha: Tensor  # (1, H, W) of the Gaussians
    colors: Tensor  # (3, H, W) of the environment map at each pixel
    grid: Tensor  # (H, W, 2) sampling positions, by EnvironmentMap.grid


@dataclass(frozen=True)
class Rendered:
    image: Tensor  # (3, H, W), not clamped
    composite: Composite | None  # None without an environment map
    gaussians: RenderOutput  # the requested outputs of the Gaussians alone


@dataclass(frozen=True)
class OutputGradients:
    """∂L/∂output of the Gaussians besides their colour, as Rasterizer.backward takes it. None: zero."""

    d_alpha: Tensor | None = None  # (1, H, W)
    d_depth: Tensor | None = None  # (1, H, W)
    d_flow: Tensor | None = None  # (2, H, W)


NO_GRADIENTS = OutputGradients()


def render_image(rasterizer: Rasterizer, model: Model, request: Request) -> Tensor:
    """(3, H, W), not clamped, without what a backward pass needs. request: as `render`."""
    return render(rasterizer, model, request, differentiable=False).image


def render(rasterizer: Rasterizer, model: Model, request: Request, differentiable: bool = True) -> Rendered:
    """Render the image of `model`, and the other outputs of the request of its Gaussians alone.

    An environment map replaces the request's background.
    """
    gaussians, environment_map = model.gaussians(), model.environment_map
    if environment_map is None:
        out = rasterizer.render(gaussians, replace(request, outputs=("color", *request.outputs)), differentiable)
        assert out.color is not None
        return Rendered(out.color, None, out)
    request = replace(request, outputs=("color", "alpha", *request.outputs), background=(0.0, 0.0, 0.0))
    out = rasterizer.render(gaussians, request, differentiable)
    assert out.color is not None and out.alpha is not None
    grid = environment_map.grid(request.camera)
    colors = environment_map.sample(grid)
    return Rendered(out.color + (1 - out.alpha) * colors, Composite(out.alpha, colors, grid), out)


def backward(
    rasterizer: Rasterizer,
    model: Model,
    rendered: Rendered,  # by the last `render` with this rasterizer and model
    d_image: Tensor,  # (3, H, W) ∂L/∂image
    gradients: Gradients,
    d_environment_map: Tensor | None = None,  # (3, h, 2h); None: the environment map is not trained
    d_outputs: OutputGradients = NO_GRADIENTS,  # of the Gaussians alone
) -> ViewGradient:
    """Add ∂L/∂parameters to `gradients` and ∂L/∂environment map to `d_environment_map`, both in place."""
    composite = rendered.composite
    if composite is None:
        return rasterizer.backward(gradients, d_color=d_image, **vars(d_outputs))
    if d_environment_map is not None:
        assert model.environment_map is not None
        model.environment_map.add_gradient(d_environment_map, composite.grid, (1 - composite.alpha) * d_image)
    d_alpha = -(d_image * composite.colors).sum(dim=0, keepdim=True)
    if d_outputs.d_alpha is not None:
        d_alpha += d_outputs.d_alpha
    return rasterizer.backward(gradients, d_color=d_image, **{**vars(d_outputs), "d_alpha": d_alpha})
