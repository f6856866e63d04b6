"""Errors of each variant on a crop, against the reference implementation, and its time on the whole workload."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from types import ModuleType

import torch
from torch import Tensor

from pipeline.studies.kernel_precision.reference_rendering import Rendered, render_reference
from pipeline.studies.kernel_precision.variants import TRADES, Variant
from rasterizer import Gaussians, Gradients, Rasterizer
from rasterizer.bench.workloads import Workload
from rasterizer.reference.blend import Thresholds

FRAMES_IN_A_ROW = 4  # of one variant: the first after another variant has cold caches


@dataclass(frozen=True)
class Errors:
    """Errors of an image in [0, 1] and of the gradients of a loss.

    Gradient errors are relative, as the fields have different units. gradient_rms: for each field the RMS error over
    the RMS of the truth, root mean square over the fields. gradient_max: the largest error over the largest value of
    the truth, maximum over the fields.
    """

    image_max: float
    image_rms: float
    psnr: float  # dB, inf where the images are equal
    gradient_rms: float
    gradient_max: float

    @classmethod
    def of(cls, rendered: Rendered, truth: Rendered) -> Errors:
        difference = rendered.color.double() - truth.color.double()
        mean_square = difference.square().mean().item()
        rms, largest = [], []
        for name, gradient in truth.gradients.items():
            error, size = rendered.gradients[name].double() - gradient.double(), gradient.double()
            if size.any():  # otherwise the loss does not depend on the field
                rms.append((error.norm() / size.norm()).item())
                largest.append((error.abs().max() / size.abs().max()).item())
        return cls(
            difference.abs().max().item(),
            math.sqrt(mean_square),
            -10 * math.log10(mean_square) if mean_square else math.inf,
            math.sqrt(sum(r * r for r in rms) / len(rms)),
            max(largest),
        )


@dataclass(frozen=True)
class Point:
    """One variant, measured. Times and counts are NaN where they were not measured. Fields are the CSV's columns."""

    name: str
    trade: str
    label: str
    milliseconds: float  # forward and backward of the whole workload, CPU time of one thread, minimum
    forward_ms: float
    noise: float  # (minimum of the worse half of the rounds - minimum) / minimum
    alive: float  # Gaussians with p(t) above the cut-off, whole workload
    pairs: float  # (pixel, Gaussian) pairs evaluated, whole workload
    errors: Errors  # against the reference without any threshold
    own: Errors  # against the reference without the thresholds that this trade-off varies
    rounding: Errors  # against the reference with the same thresholds


def _in_type(workload: Workload, d_color: Tensor, dtype: torch.dtype) -> tuple[Gaussians, Gradients, Tensor]:
    """(Gaussians, gradients, d_color) in the floating-point type of a kernel."""
    gaussians = workload.gaussians.to(dtype)
    return gaussians, Gradients.zeros_like(gaussians), d_color.to(dtype)


def render_kernel(kernel: ModuleType, workload: Workload, d_color: Tensor) -> Rendered:
    frame = Rasterizer(1, kernel)
    gaussians, gradients, d_color = _in_type(workload, d_color, frame.dtype)
    color = frame.render(gaussians, workload.request()).color
    assert color is not None  # the default output of a request
    frame.backward(gradients, d_color=d_color)
    return Rendered(color, gradients.dense() | {"sh": gradients.sh(kernel=kernel)})


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
    """Minimum over rounds. A round times all kernels in turn, so that load by other programs affects all alike."""
    request, d_color = workload.request(), workload.image_gradient()
    input_of = cache(lambda dtype: _in_type(workload, d_color, dtype))
    spent: dict[str, list[tuple[float, float]]] = {name: [] for name in kernels}
    counts: dict[str, tuple[int, int]] = {}
    for _ in range(rounds):
        for name, kernel in kernels.items():
            frame, best = Rasterizer(1, kernel), (math.inf, math.inf)
            gaussians, gradients, d_image = input_of(frame.dtype)
            for _ in range(FRAMES_IN_A_ROW):
                gradients.zero_(kernel=kernel)
                start = clock()
                frame.render(gaussians, request)
                middle = clock()
                frame.backward(gradients, d_color=d_image)
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
    """All variants, and the reference implementation in float64 and float32 with the default thresholds, not timed.

    Errors are measured on `crop`, times on `workload`.
    """
    d_color, found = crop.image_gradient(), {}
    reference = cache(lambda thresholds: render_reference(crop, d_color, thresholds))
    for variant in variants:
        log(f"errors: {variant.name}")
        found[variant] = render_kernel(kernels[variant.name], crop, d_color)
    log("times")
    times = time_kernels(kernels, workload, rounds)
    points = []
    for variant, rendered in found.items():
        thresholds = variant.choices.thresholds()
        own = without_varied(thresholds, TRADES[variant.trade])
        points.append(_point(variant, times[variant.name], rendered, reference, thresholds, own))
    default = Thresholds()
    single = render_reference(crop, d_color, default, torch.float32)
    for name, rendered in (("float64", reference(default)), ("float32", single)):
        variant = Variant(f"reference_{name}", "reference", f"reference implementation, {name}")
        points.append(_point(variant, UNTIMED, rendered, reference, default, default))
    return points


def without_varied(thresholds: Thresholds, trade: Thresholds) -> Thresholds:
    """The thresholds of a variant, zero where its trade-off varies them."""
    return Thresholds(
        *(0 if getattr(trade, name) == 0 else getattr(thresholds, name) for name in Thresholds.__dataclass_fields__)
    )


def _point(
    variant: Variant,
    timing: Timing,
    rendered: Rendered,
    reference: Callable[[Thresholds], Rendered],
    same: Thresholds,
    own: Thresholds,
) -> Point:
    return Point(
        variant.name,
        variant.trade,
        variant.label,
        **vars(timing),
        errors=Errors.of(rendered, reference(Thresholds(0, 0, 0))),
        own=Errors.of(rendered, reference(own)),
        rounding=Errors.of(rendered, reference(same)),
    )
