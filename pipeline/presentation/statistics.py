"""Statistics over seeds: means with their 95 % t-intervals, paired differences, and verdicts on these."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

CONFIDENCE = 0.95
MIN_SEEDS = 3  # with fewer the standard deviation is too uncertain
FORMULA = (
    "Differences are paired: of the runs with the same seed, means ± half the 95 % t-interval, t(n − 1) s / √n with s "
    "the standard deviation of the n differences. A mean over scenes has the interval of its n scenes. Verdict: worse "
    "or better where the paired t-test's p is at most 5 % after Holm's correction over the verdicts of the table, else "
    "no difference shown. A verdict needs n ≥ 3."
)


@dataclass(frozen=True)
class Estimate:
    """The mean of a quantity that is measured once per seed."""

    mean: float
    std: float  # over seeds, n - 1 in the denominator; NaN for one seed
    n: int

    @property
    def half_width(self) -> float:
        """Of the t-interval of the mean; NaN for one seed."""
        return math.nan if self.n < 2 else interval_scale(self.n) * self.std

    @property
    def p_value(self) -> float:
        """Two-sided, of the hypothesis that the true mean is 0; NaN for one seed."""
        if self.n < 2 or self.mean == self.std == 0:
            return math.nan if self.n < 2 else 1.0
        if self.std == 0:
            return 0.0
        return float(2 * stats.t.sf(abs(self.mean) * math.sqrt(self.n) / self.std, self.n - 1))


def interval_scale(n: int) -> float:
    """Half the t-interval of the mean of n values, over their standard deviation."""
    return float(stats.t.ppf(0.5 + 0.5 * CONFIDENCE, n - 1)) / math.sqrt(n)


def estimate(values: Iterable[float]) -> Estimate | None:
    """Mean and sample standard deviation; None if a value is NaN, since a mean over some seeds would mislead."""
    array = np.asarray(list(values), dtype=np.float64)
    if array.size == 0 or np.isnan(array).any():
        return None
    return Estimate(float(array.mean()), float(array.std(ddof=1)) if array.size > 1 else math.nan, array.size)


def holm(p_values: Sequence[float]) -> list[float]:
    """p values adjusted by Holm's step-down method (Holm 1979), in the order given."""
    order = np.argsort(p_values, kind="stable")
    adjusted, largest = [0.0] * len(p_values), 0.0
    for place, index in enumerate(order):
        largest = max(largest, min(1.0, (len(p_values) - place) * p_values[index]))
        adjusted[index] = largest
    return adjusted


def verdicts(differences: Sequence[Estimate], better: Sequence[str]) -> list[str]:
    """Of each difference `worse`, `better`, `no difference shown` or `too few`, by FORMULA. better: which
    direction is, `higher` or `lower`, as in metrics.Metric."""
    enough = [found for found in differences if found.n >= MIN_SEEDS]
    adjusted = iter(holm([found.p_value for found in enough]))
    words = []
    for found, direction in zip(differences, better, strict=True):
        if found.n < MIN_SEEDS:
            words.append(f"too few ({found.n} of {MIN_SEEDS})")
        elif next(adjusted) > 1 - CONFIDENCE:
            words.append("no difference shown")
        else:
            words.append("better" if (found.mean > 0) == (direction != "lower") else "worse")
    return words
