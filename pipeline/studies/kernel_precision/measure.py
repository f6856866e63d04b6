"""A variant's errors, on a crop that the twin can afford, and its time, on the whole workload."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from types import ModuleType

import torch
from torch import Tensor

from pipeline.studies.kernel_precision.truth import Rendered, render_reference
from pipeline.studies.kernel_precision.variants import TRADES, Variant
from rasterizer import Gaussians, Gradients, Rasterizer
from rasterizer.reference.blend import Thresholds
from rasterizer.timing.workloads import Workload

TOGETHER = 4  # frames of one variant in a row: the first after another variant finds strange caches


@dataclass(frozen=True)
class Errors:
    """Of an image in [0, 1] and of a loss's gradients.

    Gradients are relative, for the fields differ in unit: the fields' RMS error over the truth's RMS, and largest error
    over the truth's largest, of which the root mean square and the largest over the fields are given.
    """

    image_max: float
    image_rms: float
    psnr: float  # dB, inf where nothing differs
    gradient_rms: float
    gradient_max: float

    @classmethod
    def of(cls, found: Rendered, truth: Rendered) -> Errors:
        difference = found.color.double() - truth.color.double()
        mean_square = difference.square().mean().item()
        rms, largest = [], []
        for name, gradient in truth.gradients.items():
            off, size = found.gradients[name].double() - gradient.double(), gradient.double()
            if size.any():  # else the loss does not depend on it
                rms.append((off.norm() / size.norm()).item())
                largest.append((off.abs().max() / size.abs().max()).item())
        return cls(
            difference.abs().max().item(),
            math.sqrt(mean_square),
            -10 * math.log10(mean_square) if mean_square else math.inf,
            math.sqrt(sum(r * r for r in rms) / len(rms)),
            max(largest),
        )


@dataclass(frozen=True)
class Point:
    """One line of the table. Times and counts are NaN where they were not measured."""

    name: str
    trade: str
    label: str
    milliseconds: float  # forward and backward of the whole workload, CPU time of one thread, minimum
    forward_ms: float
    noise: float  # (minimum of the worse half of the rounds - minimum) / minimum
    alive: float  # Gaussians with p(t) above the cut-off, whole workload
    pairs: float  # (pixel, Gaussian) evaluated, whole workload
    errors: Errors  # against the twin without any threshold
    own: Errors  # against the twin without the thresholds that this trade-off is about
    rounding: Errors  # against the twin with the same thresholds


class Twins:
    """The twin's renderings of one workload, each made once."""

    def __init__(self, workload: Workload) -> None:
        self.workload, self.d_color = workload, workload.image_gradient()
        self._made: dict[Thresholds, Rendered] = {}

    def __call__(self, thresholds: Thresholds) -> Rendered:
        if thresholds not in self._made:
            self._made[thresholds] = render_reference(self.workload, self.d_color, thresholds)
        return self._made[thresholds]


@dataclass(frozen=True)
class _Typed:
    """What a frame reads and what it adds to, in the type that its kernel computes in."""

    gaussians: Gaussians
    gradients: Gradients
    d_color: Tensor

    @classmethod
    def of(cls, gaussians: Gaussians, d_color: Tensor, dtype: torch.dtype) -> _Typed:
        gaussians = gaussians.to(dtype)
        return cls(gaussians, Gradients.zeros_like(gaussians), d_color.to(dtype))


def render_kernel(kernel: ModuleType, workload: Workload, d_color: Tensor) -> Rendered:
    frame = Rasterizer(1, kernel)
    typed = _Typed.of(workload.gaussians, d_color, frame.dtype)
    color = frame.render(typed.gaussians, workload.request()).color
    frame.backward(typed.gradients, d_color=typed.d_color)
    return Rendered(color, typed.gradients.dense() | {"sh": typed.gradients.sh(kernel=kernel)})


@dataclass(frozen=True)
class Timing:
    milliseconds: float
    forward_ms: float
    noise: float
    alive: float
    pairs: float


UNTIMED = Timing(*[math.nan] * 5)


def time_kernels(
    kernels: Mapping[str, ModuleType], workload: Workload, rounds: int, clock: Callable[[], float] = time.process_time
) -> dict[str, Timing]:
    """Minimum over rounds of all kernels in turn, so that each meets the same quiet and busy minutes."""
    request, d_color = workload.request(), workload.image_gradient()
    typed_as = cache(lambda dtype: _Typed.of(workload.gaussians, d_color, dtype))
    spent: dict[str, list[tuple[float, float]]] = {name: [] for name in kernels}
    counts: dict[str, tuple[int, int]] = {}
    for _ in range(rounds):
        for name, kernel in kernels.items():
            frame, best = Rasterizer(1, kernel), (math.inf, math.inf)
            typed = typed_as(frame.dtype)
            for _ in range(TOGETHER):
                typed.gradients.zero_(kernel=kernel)
                start = clock()
                frame.render(typed.gaussians, request)
                middle = clock()
                frame.backward(typed.gradients, d_color=typed.d_color)
                end = clock()
                best = min(best[0], end - start), min(best[1], middle - start)
            spent[name].append(best)
            if name not in counts:
                counts[name] = frame.alive, frame.count_pairs()[0]
    found = {}
    for name, times in spent.items():
        total = [1e3 * both for both, _ in times]
        halves = [min(total[0::2]), min(total[1::2] or total)]
        found[name] = Timing(
            min(total),
            1e3 * min(forward for _, forward in times),
            max(halves) / min(halves) - 1,
            *map(float, counts[name]),
        )
    return found


def measure(
    variants: Sequence[Variant],
    kernels: Mapping[str, ModuleType],
    workload: Workload,
    crop: Workload,
    rounds: int,
    log: Callable[[str], None] = lambda line: None,
) -> list[Point]:
    """All variants, and the twin itself in float64 and float32 with the kernel's thresholds; its time is not taken."""
    twins, found = Twins(crop), {}
    for variant in variants:
        log(f"errors: {variant.name}")
        found[variant] = render_kernel(kernels[variant.name], crop, twins.d_color)
    log("times")
    times = time_kernels(kernels, workload, rounds)
    points = []
    for variant, rendered in found.items():
        thresholds = variant.choices.thresholds()
        free = without(thresholds, TRADES[variant.trade])
        points.append(
            _point(variant.name, variant.trade, variant.label, times[variant.name], rendered, twins, thresholds, free)
        )
    own = Thresholds()
    single = render_reference(crop, twins.d_color, own, torch.float32)
    for name, rendered in (("float64", twins(own)), ("float32", single)):
        points.append(
            _point(f"twin_{name}", "readable twin", f"readable twin, {name}", UNTIMED, rendered, twins, own, own)
        )
    return points


def without(thresholds: Thresholds, trade: Thresholds) -> Thresholds:
    """The variant's thresholds, except those that its trade-off sets to zero."""
    return Thresholds(
        *(0 if getattr(trade, name) == 0 else getattr(thresholds, name) for name in Thresholds.__dataclass_fields__)
    )


def _point(
    name: str,
    trade: str,
    label: str,
    timing: Timing,
    rendered: Rendered,
    twins: Twins,
    same: Thresholds,
    free: Thresholds,
) -> Point:
    return Point(
        name,
        trade,
        label,
        **vars(timing),
        errors=Errors.of(rendered, twins(Thresholds(0, 0, 0))),
        own=Errors.of(rendered, twins(free)),
        rounding=Errors.of(rendered, twins(same)),
    )
