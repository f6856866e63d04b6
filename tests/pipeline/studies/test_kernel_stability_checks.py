"""The further checks of kernel stability: each finds no error where there is none, and finds one that is made."""

from __future__ import annotations

import math

import torch

from pipeline.studies.kernel_stability.__main__ import checks_table
from pipeline.studies.kernel_stability.checks import Check
from pipeline.studies.kernel_stability.long_training import distance, train
from pipeline.studies.kernel_stability.on_the_cut_off import cut_off_checks
from pipeline.studies.kernel_stability.sampled import errors_at
from pipeline.studies.kernel_stability.scenes import base_gaussians, base_request
from rasterizer.kernel_loader import kernel
from rasterizer.reference.discontinuities import away_from_discontinuities


def test_chosen_pixels_agree_with_the_reference_unless_gaussians_are_missing() -> None:
    """1e-5 and 1e-4: as instruction sets differ (test_kernel_stability.py)."""
    request = base_request()
    gaussians = away_from_discontinuities(base_gaussians(24, 0).to(torch.float32).to(torch.float64), request)
    pixels = torch.cartesian_prod(torch.arange(0, 32, 2), torch.arange(24))
    image, gradient, compared = errors_at(gaussians, request, pixels)
    assert image < 1e-5 and gradient < 1e-4 and compared > 0.9 * len(pixels)
    assert errors_at(gaussians, request, pixels, min_marginal=0.5)[0] > 0.01


def test_on_the_cut_off_either_side_is_shown_or_not() -> None:
    """Within the distance all are shown, beyond it none; on it those that the kernel shows are right."""
    checks = {check.name.split()[3]: check for check in cut_off_checks()}
    shown, every = map(int, checks["0.9999"].compared.split(" Gaussians")[0].split(" of "))
    assert shown == every > 300
    assert checks["1.0001"].compared.startswith("0 of ") and math.isnan(checks["1.0001"].image)
    assert checks["0.9999"].image < 1e-4 and not any(check.exceeded for check in checks.values())
    part = checks["1"].compared.split(" Gaussians")[0]
    shown, every = map(int, part.split(" of "))
    assert 0 < shown < every, "rounding decides on the cut-off itself"


def test_a_rounded_start_is_carried_by_the_training() -> None:
    one, other, moved = train(kernel, 100), train(kernel, 100), train(kernel, 100, moved_by=2.0**-20)
    assert [reached.step for reached in one] == [0, 1, 10, 100]
    assert all(distance(a, b) == 0 for a, b in zip(one, other, strict=True))
    assert 0 < distance(moved[0], one[0]) < 2.0**-19
    assert one[-1].psnr > one[0].psnr + 1


def test_the_table_says_what_is_not_compared_and_what_is_exceeded() -> None:
    nan = math.nan
    table = checks_table(
        [Check("a", "nothing", nan, nan, 1e-3, 1e-3), Check("b", "one", 2e-3, nan, 1e-3, math.inf, "x")]
    )
    assert "| a | nothing | n/a | n/a | 0.001, 0.001 |" in table
    assert "| b | one | 2.0e-03 | n/a | 0.001 (x) **exceeded** |" in table
