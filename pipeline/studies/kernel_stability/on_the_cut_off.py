"""Gaussians on the temporal cut-off, p(t) = 0.05 to rounding: whether one is shown is decided by rounding, so the
float64 reference renders those that the kernel shows."""

from __future__ import annotations

from dataclasses import replace

import torch

from pipeline.studies.kernel_stability.cases import BOUND
from pipeline.studies.kernel_stability.checks import Check
from pipeline.studies.kernel_stability.sampled import errors_at
from pipeline.studies.kernel_stability.scenes import FAMILIES
from rasterizer import Gradients, Rasterizer
from rasterizer.reference.blend import MIN_MARGINAL
from rasterizer.reference.discontinuities import away_from_discontinuities
from rasterizer.reference.render import slice_in_time

PARTS = (0.9999, 1 - 1e-6, 1.0, 1 + 1e-6, 1.0001)  # of the distance in time where p(t) = 0.05
SEEDS = 20
ROUNDING = 1e-5  # p further from the cut-off than this, relatively, is on the same side of it in float32


def cut_off_checks() -> list[Check]:
    return [_check(part) for part in PARTS]


def _check(part: float) -> Check:
    shown = wrong = compared = everything = 0
    image = gradient = 0.0
    for seed in range(SEEDS):
        gaussians, request = FAMILIES["cut_off"].build(0.9, seed)
        gaussians = away_from_discontinuities(gaussians, request)  # of other kinds
        mean = gaussians.mean.clone()
        mean[:, 3] = request.time + (mean[:, 3] - request.time) * (part / 0.9)
        gaussians = replace(gaussians, mean=mean.to(torch.float32).to(torch.float64))
        everything += len(gaussians)
        frame, single = Rasterizer(threads=1), gaussians.to(torch.float32)
        frame.render(single, request)
        color = torch.zeros(3, request.camera.height, request.camera.width)
        rows = frame.backward(Gradients.zeros_like(single), d_color=color).visible.long()
        p = slice_in_time(gaussians, request.time).marginal
        certain = (p / MIN_MARGINAL - 1).abs() > ROUNDING
        is_shown = torch.zeros(len(gaussians), dtype=torch.bool).index_fill_(0, rows, True)
        wrong += int((certain & is_shown & (p < MIN_MARGINAL)).sum())
        if not len(rows):
            continue
        camera = request.camera
        grid = torch.cartesian_prod(torch.arange(camera.width), torch.arange(camera.height))
        found = errors_at(gaussians.rows(rows), request, grid, min_marginal=0.5 * MIN_MARGINAL)
        image, gradient = max(image, found[0]), max(gradient, found[1])
        shown, compared = shown + len(rows), compared + found[2]
    nan = float("nan")
    return Check(
        f"cut-off in time, {part:.7g} of its distance",
        f"{shown} of {everything} Gaussians shown, {wrong} of them wrongly; {compared} pixels",
        (image if not wrong else float("inf")) if shown or wrong else nan,
        gradient if shown else nan,
        BOUND,
        BOUND,
    )
