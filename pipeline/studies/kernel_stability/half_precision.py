"""Coefficients stored in 16 bits, in every case of the families: the kernel built for them against float64 with the
coefficients as they were before rounding."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch

from pipeline.studies.kernel_precision.build import load_variants
from pipeline.studies.kernel_precision.variants import all_variants
from pipeline.studies.kernel_stability.cases import Case
from pipeline.studies.kernel_stability.checks import Check
from pipeline.studies.kernel_stability.instruction_sets import by_kernel
from pipeline.studies.kernel_stability.measure import (
    call,
    full_scale,
    images_and_gradients,
    relative_error,
    shown,
    weights_of,
)
from rasterizer.reference import render as reference
from rasterizer.reference.discontinuities import away_from_discontinuities, smooth_pixels

# Half a unit in the last place, 2^-11 and 2^-8, × the sum of a colour's terms, which is at most 8 in these scenes.
BOUNDS = {"sh_float16": 4e-3, "sh_bfloat16": 3.2e-2}


def half_precision_checks(cases: Sequence[Case]) -> list[Check]:
    """The largest errors over the cases that show something; gradients of opacity and colour, whose terms do not
    cancel."""
    kernels = load_variants([variant for variant in all_variants() if variant.name in BOUNDS])
    worst = dict.fromkeys(BOUNDS, (0.0, 0.0))
    compared = 0
    for case in cases:
        gaussians, request = case.scene()
        away = away_from_discontinuities(gaussians, request)
        smooth = smooth_pixels(away, request)
        truth = call(reference.rasterize, away, request)
        assert truth.color is not None
        full_color = truth.color.detach()
        if not shown(away, request):
            continue
        compared += 1
        weights, scale = weights_of(truth, request, smooth), full_scale(truth, request)
        _, expected = images_and_gradients(reference.rasterize, away, request, weights)
        for name in BOUNDS:
            images, gradients = by_kernel(kernels[name], 1, away.to(torch.float32), request, weights)
            image = relative_error(images["color"] * smooth, full_color * smooth, scale["color"])
            fields = [(gradients[field], expected[field]) for field in ("opacity_logit", "sh")]
            gradient = max(relative_error(a, b, max(b.abs().max().item(), 1e-30)) for a, b in fields)
            worst[name] = max(worst[name][0], image), max(worst[name][1], gradient)
    why = "rounding of 48 coefficients"
    return [
        Check(f"coefficients in {name.removeprefix('sh_')}", f"{compared} cases", *worst[name], bound, math.inf, why)
        for name, bound in BOUNDS.items()
    ]
