"""Renders a view of a model: the Gaussians, composited over its environment or cube map where it has one.

    image = colour + (1 - alpha) · environment_map(direction of the pixel)

Training and evaluation both render through here. Without an environment map the image is the rasterizer's, bit for bit.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace

import torch
from torch import Tensor

from pipeline.model.model import Model
from rasterizer import Engine, Gradients, RenderOutput, Request, ViewGradient, engine_for, render_batch

VIEWS_AT_ONCE = 4  # of `render_each`: as many as a batch of training has


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
    flow: Tensor | None = None  # (2, H, W) pixels; None unless requested
    alpha: Tensor | None = None  # (1, H, W) of the Gaussians; None unless requested
    depth: Tensor | None = None  # (1, H, W) Σ w z of the Gaussians; None unless requested


@dataclass(frozen=True)
class ImageGradient:
    """A loss, and its gradients by what `render` returned, of the same shapes; None: zero."""

    loss: float = 0.0
    image: Tensor | None = None
    flow: Tensor | None = None
    alpha: Tensor | None = None  # besides that by the image
    depth: Tensor | None = None

    def __add__(self, other: ImageGradient) -> ImageGradient:
        pairs = {name: (tensor, getattr(other, name)) for name, tensor in self._tensors().items()}
        sums = {name: a if b is None else b if a is None else a + b for name, (a, b) in pairs.items()}
        return ImageGradient(self.loss + other.loss, **sums)

    def over(self, views: int) -> ImageGradient:
        """The gradients of the mean over a batch of `views` views; the loss stays that of this view."""
        divided = {name: None if tensor is None else tensor / views for name, tensor in self._tensors().items()}
        return ImageGradient(self.loss, **divided)

    def inside(self, mask: Tensor) -> ImageGradient:
        """Zero gradients for the pixels outside `mask`, (H, W) bool."""
        masked = {
            n: None if tensor is None else torch.where(mask, tensor, 0.0) for n, tensor in self._tensors().items()
        }
        return ImageGradient(self.loss, **masked)

    def _tensors(self) -> dict[str, Tensor | None]:
        return {f.name: getattr(self, f.name) for f in fields(self) if f.name != "loss"}


def render_image(rasterizer: Engine, model: Model, request: Request) -> Tensor:
    """(3, H, W), not clamped, without what a backward pass needs. request: as `render`."""
    return render(rasterizer, model, request, differentiable=False).image


def render(rasterizer: Engine, model: Model, request: Request, differentiable: bool = True) -> Rendered:
    """Render the colour of `model`, and flow, alpha and depth of its Gaussians on request.

    An environment map or cube map replaces the request's background.
    """
    return render_views([rasterizer], model, [request], differentiable)[0]


def render_views(
    rasterizers: Sequence[Engine], model: Model, requests: Sequence[Request], differentiable: bool = True
) -> list[Rendered]:
    """As `render` with each rasterizer, all of one kind."""
    complete = [_with_outputs(model, request) for request in requests]
    found = render_batch(rasterizers, model.gaussians(), complete, differentiable)
    return [_composited(model, request, out) for request, out in zip(complete, found, strict=True)]


def render_each(
    backend: str, threads: int, model: Model, requests: Sequence[Request], differentiable: bool = True
) -> Iterator[tuple[Engine, Rendered]]:
    """As `render` of every request, in their order; the Gaussians are read once for VIEWS_AT_ONCE of them.

    backend, threads: of `engine_for`. Yields the engine too, for `backward`, which must come before the next view.
    """
    engines = [engine_for(backend, threads) for _ in range(min(VIEWS_AT_ONCE, len(requests)))]
    for first in range(0, len(requests), VIEWS_AT_ONCE):
        views = requests[first : first + VIEWS_AT_ONCE]
        yield from zip(engines, render_views(engines[: len(views)], model, views, differentiable))


def _with_outputs(model: Model, request: Request) -> Request:
    """The request of the rasterizer: colour too, and what compositing over an environment map needs."""
    also = tuple(name for name in ("alpha", "depth", "flow") if name in request.outputs)
    if model.environment_map is None:
        return replace(request, outputs=("color", *also))
    return replace(request, outputs=("color", "alpha", *also), background=(0.0, 0.0, 0.0))


def _composited(model: Model, request: Request, out: RenderOutput) -> Rendered:
    assert out.color is not None
    if model.environment_map is None:
        return Rendered(out.color, None, out.flow, out.alpha, out.depth)
    assert out.alpha is not None
    grid = model.environment_map.grid(request.camera)
    colors = model.environment_map.sample(grid)
    composite = Composite(out.alpha, colors, grid)
    return Rendered(out.color + (1 - out.alpha) * colors, composite, out.flow, out.alpha, out.depth)


def backward(
    rasterizer: Engine,
    model: Model,
    rendered: Rendered,  # by the last `render` with this rasterizer and model
    found: ImageGradient,
    gradients: Gradients,
    d_environment_map: Tensor | None = None,  # of the map's image; None: the map is not trained
) -> ViewGradient:
    """Add ∂L/∂parameters to `gradients` and ∂L/∂environment map to `d_environment_map`, both in place."""
    composite, d_alpha = rendered.composite, found.alpha
    if composite is not None and found.image is not None:
        if d_environment_map is not None:
            assert model.environment_map is not None
            model.environment_map.add_gradient(d_environment_map, composite.grid, (1 - composite.alpha) * found.image)
        by_image = -(found.image * composite.colors).sum(dim=0, keepdim=True)
        d_alpha = by_image if d_alpha is None else by_image + d_alpha
    return rasterizer.backward(gradients, d_color=found.image, d_alpha=d_alpha, d_depth=found.depth, d_flow=found.flow)
