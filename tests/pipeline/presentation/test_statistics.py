"""Statistics over seeds against hand computation, and the rule of verdicts."""

from __future__ import annotations

import math
import statistics

import pytest

from pipeline.presentation.statistics import Difference, difference, estimate, mean_difference


def test_mean_std_and_standard_error_by_hand() -> None:
    found = estimate([24.0, 25.0, 27.0])
    assert found.mean == pytest.approx(76 / 3)
    assert found.std == pytest.approx(statistics.stdev([24.0, 25.0, 27.0]))
    assert found.standard_error == pytest.approx(math.sqrt(7 / 3) / math.sqrt(3))  # variance by hand: 7/3
    assert math.isnan(estimate([24.0]).std)
    assert estimate([24.0, math.nan]) is None and estimate([]) is None  # no mean over some of the seeds


def test_verdict_follows_the_two_standard_error_rule() -> None:
    full = estimate([26.0, 26.2, 26.4])  # std 0.2

    def verdict(*values: float, better: str = "higher") -> str:
        return difference(estimate(values), full).verdict(better)

    # SE of the difference = sqrt(0.04 / 3 + 0.04 / 3) = 0.16330, so the threshold is 0.32660 dB
    assert verdict(25.67, 25.87, 26.07) == "worse"
    assert verdict(25.68, 25.88, 26.08) == "no difference shown"
    assert verdict(26.33, 26.53, 26.73) == "better"
    assert verdict(26.33, 26.53, 26.73, better="lower") == "worse"
    assert verdict(25.67, 25.87, 26.07, better="lower") == "better"
    assert verdict(20.0, 20.1) == "too few seeds (2 of 3)"
    found = difference(estimate([25.0, 25.2, 25.4]), full)
    assert found.mean == pytest.approx(-1.0)
    assert found.standard_error == pytest.approx(math.sqrt(0.04 / 3 + 0.04 / 3))


def test_error_of_a_mean_of_differences_is_propagated() -> None:
    found = mean_difference([Difference(2.0, 1.0, 3), Difference(1.0, 0.0, 2)])
    assert found == Difference(1.5, 0.5, 2)
