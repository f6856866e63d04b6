"""Errors of a float32 program in a case: images, gradients and optimiser steps against the float64 reference."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields

import torch
from torch import Tensor

from pipeline.studies.kernel_stability.scenes import generator
from rasterizer import Gaussians, Gradients, Rasterizer, RenderOutput, Request
from rasterizer.reference import render as reference
from rasterizer.reference.discontinuities import away_from_discontinuities, smooth_pixels

LEARNING_RATE = 1e-3  # of the optimiser steps, on every parameter
EPSILON = 1e-8  # of Adam: with 1e-15 a gradient that is rounding error alone gives a step as large as any other


@dataclass(frozen=True)
class Errors:
    """Errors of one program in one case: images relative to full scale, gradients to the largest of their tensor."""

    image: float
    gradient: float
    worst_field: str  # with the largest gradient error
    steps: float  # |loss after the optimiser steps - the reference's| / loss before them
    non_finite: int  # values of images, gradients and stepped parameters
    indefinite: int  # 2D covariances that are not positive definite


def call(rasterize: Callable[..., RenderOutput], gaussians: Gaussians, request: Request) -> RenderOutput:
    return rasterize(gaussians, **{field.name: getattr(request, field.name) for field in fields(request)})


def leaves_of(gaussians: Gaussians) -> dict[str, Tensor]:
    return {name: tensor.detach().clone().requires_grad_() for name, tensor in gaussians.tensors().items()}


def full_scale(truth: RenderOutput, request: Request) -> dict[str, float]:
    """The largest value of each image, at least 1 for colour and alpha and 1 pixel for flow.

    Flow of nearly static Gaussians has no relative accuracy in float32.
    """
    scale = {name: getattr(truth, name).detach().abs().max().item() for name in request.outputs}
    least = {"color": 1.0, "alpha": 1.0, "flow": 1.0}
    return {name: max(value, least.get(name, 1e-30)) for name, value in scale.items()}


def weights_of(truth: RenderOutput, request: Request, smooth: Tensor) -> dict[str, Tensor]:
    """Random ∂L/∂image, divided by full scale; zero at pixels that are not `smooth` (H, W)."""
    rng, scale = generator(99), full_scale(truth, request)
    return {
        name: torch.randn(getattr(truth, name).shape, generator=rng, dtype=torch.float64) * smooth / scale[name]
        for name in request.outputs
    }


def images_and_gradients(
    rasterize: Callable[..., RenderOutput], gaussians: Gaussians, request: Request, weights: dict[str, Tensor]
) -> tuple[RenderOutput, dict[str, Tensor]]:
    """∂L/∂parameter by name for L = Σ weights · images."""
    leaves = leaves_of(gaussians)
    out = call(rasterize, Gaussians.from_tensors(leaves), request)
    loss = sum((getattr(out, name) * weight.to(gaussians.mean.dtype)).sum() for name, weight in weights.items())
    found = torch.autograd.grad(loss, list(leaves.values()), allow_unused=True) if loss.requires_grad else [None] * 6
    return out, {
        name: torch.zeros_like(leaf) if g is None else g for (name, leaf), g in zip(leaves.items(), found, strict=False)
    }


def relative_error(found: Tensor, truth: Tensor, scale: float) -> float:
    """The largest |found - truth| / scale; infinite where `found` is not finite."""
    if truth.numel() == 0:
        return 0.0
    error = (found.double() - truth.double()).abs().max().item()
    return (error / scale if error else 0.0) if math.isfinite(error) else math.inf


def count_non_finite(tensors: list[Tensor]) -> int:
    return sum(int((~torch.isfinite(tensor)).sum()) for tensor in tensors)


def optimise(
    rasterize: Callable[..., RenderOutput],
    gaussians: Gaussians,
    request: Request,
    target: RenderOutput,
    scale: dict[str, float],
    steps: int,
) -> tuple[float, dict[str, Tensor]]:
    """The loss after `steps` steps of Adam towards `target`, and the parameters after them.

    The loss is Σ over the outputs of the mean square of (image - target) / full scale.
    """
    leaves = leaves_of(gaussians)
    optimiser = torch.optim.Adam(list(leaves.values()), lr=LEARNING_RATE, eps=EPSILON)
    for step in range(steps + 1):
        out = call(rasterize, Gaussians.from_tensors(leaves), request)
        loss = sum(
            (((getattr(out, name) - getattr(target, name).to(leaves["mean"].dtype)) / scale[name]) ** 2).mean()
            for name in request.outputs
        )
        if step == steps or not loss.requires_grad or not torch.isfinite(loss):
            return loss.item(), leaves
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    raise AssertionError("unreachable")


def step_error(
    rasterize: Callable[..., RenderOutput], gaussians: Gaussians, request: Request, steps: int
) -> tuple[float, int]:
    """(|loss after the steps - the reference's| / the loss before them, number of non-finite parameters).

    The target is a rendering of the scene with its parameters jittered by 2 %.
    """
    if len(gaussians) == 0 or steps == 0:
        return 0.0, 0
    rng = generator(7)
    jittered = Gaussians.from_tensors(
        {
            name: tensor * (1 + 0.02 * torch.randn(tensor.shape, generator=rng, dtype=tensor.dtype))
            if name not in ("mean", "log_scale")
            else tensor
            for name, tensor in gaussians.tensors().items()
        }
    )
    target = call(reference.rasterize, jittered, request)
    scale = full_scale(target, request)
    before, _ = optimise(reference.rasterize, gaussians, request, target, scale, 0)
    expected, _ = optimise(reference.rasterize, gaussians, request, target, scale, steps)
    found, leaves = optimise(rasterize, gaussians.to(torch.float32), request, target, scale, steps)
    error = abs(found - expected) / max(before, 1e-6)
    return (error if math.isfinite(error) else math.inf), count_non_finite(list(leaves.values()))


def kernel_indefinite(gaussians: Gaussians, request: Request) -> int:
    """Number of visible Gaussians without a finite, positive screen-space radius, as reported by the kernel."""
    frame = Rasterizer(threads=1)
    single = gaussians.to(torch.float32)
    frame.render(single, request)
    color = torch.zeros(3, request.camera.height, request.camera.width)
    statistics = frame.backward(Gradients.zeros_like(single), d_color=color)
    return int((~(torch.isfinite(statistics.radius) & (statistics.radius > 0))).sum())


def shown(gaussians: Gaussians, request: Request) -> int:
    """Number of Gaussians that the kernel shows."""
    frame = Rasterizer(threads=1)
    frame.render(gaussians.to(torch.float32), request, differentiable=False)
    return frame.visible


def measure(
    rasterize: Callable[..., RenderOutput],
    indefinite: Callable[[Gaussians, Request], int],
    gaussians: Gaussians,
    request: Request,
    steps: int,
    dtype: torch.dtype = torch.float32,
) -> Errors:
    """Errors of a program. gaussians: float64, with values that float32 represents exactly."""
    away = away_from_discontinuities(gaussians, request)
    smooth = smooth_pixels(away, request)
    truth = call(reference.rasterize, away, request)
    weights, scale = weights_of(truth, request, smooth), full_scale(truth, request)
    _, expected = images_and_gradients(reference.rasterize, away, request, weights)
    found, gradients = images_and_gradients(rasterize, away.to(dtype), request, weights)
    image = max(
        relative_error(getattr(found, name).detach() * smooth, getattr(truth, name).detach() * smooth, scale[name])
        for name in request.outputs
    )
    by_field = {
        name: relative_error(gradients[name], exact, max(exact.abs().max().item(), 1e-30))
        for name, exact in expected.items()
        if exact.numel()
    }
    worst_field = max(by_field, key=by_field.__getitem__, default="")
    # All Gaussians, those next to a discontinuity too, must give finite images and gradients.
    ones = {name: torch.ones_like(weight) for name, weight in weights.items()}
    whole, whole_gradients = images_and_gradients(rasterize, gaussians.to(dtype), request, ones)
    values = [getattr(whole, name) for name in request.outputs] + list(whole_gradients.values())
    steps_error, non_finite = step_error(rasterize, away, request, steps)
    return Errors(
        image,
        by_field.get(worst_field, 0.0),
        worst_field,
        steps_error,
        count_non_finite(values) + non_finite,
        indefinite(gaussians.to(dtype), request),
    )
