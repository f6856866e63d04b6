"""A view of a model: its Gaussians, and behind them the environment where the model has one.

    image = colour + (1 - alpha) · environment(direction of the pixel)

Training and evaluation render through here, so that no picture can lack its background. A model without an
environment costs nothing more than the rasterizer's own call, whose image it gets, bit for bit.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from torch import Tensor

from pipeline.model.model import Model
from rasterizer import Gradients, Rasterizer, Request, ViewGradient


@dataclass(frozen=True)
class Behind:
    """What the image of a model with an environment was composed of."""

    alpha: Tensor  # (1, H, W) of the Gaussians
    colors: Tensor  # (3, H, W) of the environment behind each pixel
    grid: Tensor  # (H, W, 2) where in the environment that is


@dataclass(frozen=True)
class Rendered:
    image: Tensor  # (3, H, W), not clamped
    behind: Behind | None  # None: no environment


def render_image(frame: Rasterizer, model: Model, request: Request) -> Tensor:
    """(3, H, W), not clamped, and not for a backward pass. request: as `render`."""
    return render(frame, model, request, differentiable=False).image


def render(frame: Rasterizer, model: Model, request: Request, differentiable: bool = True) -> Rendered:
    """Render `model` with `frame`; of the request's outputs only colour is made.

    Where the model has an environment, that stands in place of the request's background.
    """
    gaussians = model.gaussians()
    if model.environment_map is None:
        request = replace(request, outputs=("color",))
        return Rendered(frame.render(gaussians, request, differentiable).color, None)
    request = replace(request, outputs=("color", "alpha"), background=(0.0, 0.0, 0.0))
    out = frame.render(gaussians, request, differentiable)
    grid = model.environment_map.grid(request.camera)
    colors = model.environment_map.look_up(grid)
    return Rendered(out.color + (1 - out.alpha) * colors, Behind(out.alpha, colors, grid))


def backward(
    frame: Rasterizer,
    model: Model,
    rendered: Rendered,  # the frame's last, by `render`
    d_image: Tensor,  # (3, H, W) ∂L/∂image
    gradients: Gradients,
    d_environment: Tensor | None = None,  # (3, h, 2h); None: the environment is not trained
) -> ViewGradient:
    """Add ∂L/∂parameters to `gradients` and ∂L/∂environment to `d_environment`, both in place."""
    behind = rendered.behind
    if behind is None:
        return frame.backward(gradients, d_color=d_image)
    if d_environment is not None:
        model.environment_map.add_gradient(d_environment, behind.grid, (1 - behind.alpha) * d_image)
    d_alpha = -(d_image * behind.colors).sum(dim=0, keepdim=True)
    return frame.backward(gradients, d_color=d_image, d_alpha=d_alpha)
