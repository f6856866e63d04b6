"""What training, evaluation and pictures ask of a rasterizer, and the two that there are."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import torch
from torch import Tensor

from rasterizer.gaussians import Gaussians
from rasterizer.gradients import Gradients, ViewGradient
from rasterizer.gsplat_rasterizer import GsplatRasterizer, gpu
from rasterizer.rasterizer import Rasterizer
from rasterizer.request import RenderOutput, Request


class Engine(Protocol):
    """Renders a view with named outputs, and differentiates it. All tensors are on its device."""

    @property
    def device(self) -> torch.device: ...

    @property
    def threads(self) -> int: ...  # of the CPU

    @property
    def alive(self) -> int: ...  # Gaussians whose temporal marginal p(t) is at least 0.05 in the last view

    def render(self, gaussians: Gaussians, request: Request, differentiable: bool = True) -> RenderOutput:
        """differentiable: False skips what only `backward` needs."""

    def backward(
        self,
        gradients: Gradients,
        d_color: Tensor | None = None,
        d_alpha: Tensor | None = None,
        d_depth: Tensor | None = None,
        d_flow: Tensor | None = None,
        d_stats: Tensor | None = None,
    ) -> ViewGradient:
        """Add the parameter gradients of the last view to `gradients`, given ∂L/∂image of its outputs (None: zero).
        Returns what density control reads."""


def render_batch(
    engines: Sequence[Engine], gaussians: Gaussians, requests: Sequence[Request], differentiable: bool = True
) -> list[RenderOutput]:
    """Render a view with each engine, all of one kind, as `render`."""
    kernels = [engine for engine in engines if isinstance(engine, Rasterizer)]
    if kernels:
        return Rasterizer.render_batch(kernels, gaussians, requests, differentiable)
    views = zip(engines, requests, strict=True)
    return [engine.render(gaussians, request, differentiable) for engine, request in views]


def engine_for(backend: str, threads: int = 0) -> Engine:
    """cpu: the compiled kernel on so many threads (0: all cores). gsplat: a GPU; raises NoGpu where there is none."""
    return GsplatRasterizer(gpu()) if backend == "gsplat" else Rasterizer(threads)


def device_of(backend: str) -> torch.device:
    """Where the tensors of its engine are. Raises NoGpu."""
    return gpu() if backend == "gsplat" else torch.device("cpu")
