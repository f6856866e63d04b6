"""Statistics over seeds against hand computation and SciPy's tests, and the rule of verdicts."""

from __future__ import annotations

import math
import statistics

import numpy as np
import pytest
from scipy import stats

from pipeline.presentation.statistics import Estimate, estimate, holm, verdicts


def test_mean_and_interval_by_hand() -> None:
    found = estimate([24.0, 25.0, 27.0])
    assert found is not None
    assert found.mean == pytest.approx(76 / 3)
    assert found.std == pytest.approx(statistics.stdev([24.0, 25.0, 27.0]))
    assert found.half_width == pytest.approx(4.302653 * math.sqrt(7 / 3 / 3))  # t(2), variance by hand: 7/3
    assert estimate([24.0, math.nan]) is None and estimate([]) is None  # no mean over some of the seeds


def test_one_seed_has_no_interval() -> None:
    one = estimate([24.0])
    assert one is not None and math.isnan(one.std) and math.isnan(one.half_width) and math.isnan(one.p_value)


def test_intervals_cover_the_mean_in_95_of_100_samples() -> None:
    """Of normal samples of three: 4,000 of them have a standard error of 0.35 %; within four of these."""
    rng = np.random.default_rng(0)
    found = [estimate(row) for row in rng.normal(1.0, 2.0, (4000, 3))]
    covered = np.mean([abs(one.mean - 1.0) <= one.half_width for one in found if one is not None])
    assert abs(covered - 0.95) < 0.014


def test_p_is_that_of_scipys_paired_test() -> None:
    full, changed = np.array([26.0, 26.2, 26.4, 26.1]), np.array([25.8, 26.1, 26.0, 26.0])
    found = estimate(changed - full)
    assert found is not None
    assert found.p_value == pytest.approx(stats.ttest_rel(changed, full).pvalue, rel=1e-12)


def test_p_without_deviation() -> None:
    assert Estimate(0.0, 0.0, 3).p_value == 1.0 and Estimate(0.1, 0.0, 3).p_value == 0.0


def test_holm_by_hand() -> None:
    """Holm (1979): the smallest is × 3, the next × 2, never less than one before it."""
    assert holm([0.02, 0.01, 0.03]) == pytest.approx([0.04, 0.03, 0.04])
    assert holm([0.5, 0.9]) == [1.0, 1.0] and holm([]) == []


def test_verdicts() -> None:
    clear, vague = Estimate(-1.0, 0.1, 3), Estimate(-0.1, 0.1, 3)
    few = Estimate(-1.0, 0.1, 2)
    assert verdicts([clear, vague, few], ["higher"] * 3) == ["worse", "no difference shown", "too few (2 of 3)"]
    assert verdicts([clear], ["lower"]) == ["better"]
    # p = 0.018 of -0.4 ± 0.1: a verdict alone, none as the largest of four beside one as weak
    weak = Estimate(-0.4, 0.1, 3)
    assert verdicts([weak], ["higher"]) == ["worse"]
    assert verdicts([weak] * 4, ["higher"] * 4) == ["no difference shown"] * 4
