"""Differences between the kernel's instruction sets, and between one thread and two, in one case.

All instruction sets are compiled from one source. They differ in vector width and in fused multiply-add, so results
may differ by rounding only.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from types import ModuleType

import torch
from torch import Tensor

from pipeline.studies.kernel_stability.measure import full_scale, relative_error, weights_of
from rasterizer import Gaussians, Gradients, Rasterizer, RenderOutput, Request
from rasterizer.kernel_loader import available_isas, load_kernel
from rasterizer.reference.discontinuities import away_from_discontinuities, smooth_pixels

Tensors = dict[str, Tensor]  # by output or field


@dataclass(frozen=True)
class Spread:
    """The largest difference between two instruction sets, away from discontinuities.

    Images are relative to full scale, gradients to the largest of their tensor.
    """

    image: float
    gradient: float
    changed_by_threads: tuple[str, ...]  # instruction sets with other bits on 2 threads than on 1


def measure_spread(gaussians: Gaussians, request: Request) -> Spread:
    """gaussians: float64, with values that float32 represents exactly."""
    isas = available_isas()
    away = away_from_discontinuities(gaussians, request)
    smooth = smooth_pixels(away, request)
    single = away.to(torch.float32)
    rendered = Rasterizer(1, load_kernel(isas[0])).render(single, request, differentiable=False)
    scale, weights = full_scale(rendered, request), weights_of(rendered, request, smooth)
    found = [images_and_gradients(isa, 1, single, request, weights) for isa in isas]
    images = [{name: image * smooth for name, image in images.items()} for images, _ in found]
    gradients = [by_field for _, by_field in found]
    by_field = [[found[name] for found in gradients] for name in gradients[0]]
    return Spread(
        max(largest_difference([i[name] for i in images], scale[name]) for name in images[0]),
        max(largest_difference(found, largest(found)) for found in by_field),
        tuple(isa for isa in isas if threads_change_bits(isa, gaussians.to(torch.float32), request, rendered)),
    )


def images_and_gradients(
    isa: str, threads: int, gaussians: Gaussians, request: Request, weights: Tensors
) -> tuple[Tensors, Tensors]:
    """`by_kernel` of the kernel for `isa`."""
    return by_kernel(load_kernel(isa), threads, gaussians, request, weights)


def by_kernel(
    kernel: ModuleType, threads: int, gaussians: Gaussians, request: Request, weights: Tensors
) -> tuple[Tensors, Tensors]:
    """The request's images, and ∂L/∂parameter for L = Σ weights · images."""
    frame, gradients = Rasterizer(threads, kernel), Gradients.zeros_like(gaussians)
    out = frame.render(gaussians, request)
    frame.backward(gradients, **{f"d_{name}": weight.to(torch.float32) for name, weight in weights.items()})
    sh = gradients.sh(threads, kernel=kernel)
    return {name: getattr(out, name) for name in request.outputs}, gradients.dense() | {"sh": sh}


def threads_change_bits(isa: str, gaussians: Gaussians, request: Request, like: RenderOutput) -> bool:
    """Whether images or gradients differ in any bit between one thread and two. like: gives the shapes."""
    ones = {name: torch.ones_like(getattr(like, name)) for name in request.outputs}
    one, two = (images_and_gradients(isa, threads, gaussians, request, ones) for threads in (1, 2))
    return any(not same_bits(a[name], b[name]) for a, b in zip(one, two, strict=True) for name in a)


def same_bits(a: Tensor, b: Tensor) -> bool:
    """Compared as bits: as numbers NaN differs from itself, and 0 equals -0."""
    return torch.equal(a.view(torch.int32), b.view(torch.int32))


def largest(tensors: list[Tensor]) -> float:
    return max([1e-30, *(tensor.abs().max().item() for tensor in tensors if tensor.numel())])


def largest_difference(tensors: list[Tensor], scale: float) -> float:
    """Between any two of them, over `scale`; infinite where one is not finite."""
    return max([0.0, *(relative_error(a, b, scale) for a, b in combinations(tensors, 2))])
