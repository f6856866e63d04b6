"""Statistics over seeds: mean, standard deviation, standard error, and the verdict on a difference."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

MIN_SEEDS = 3  # with fewer the standard error is too uncertain
STANDARD_ERRORS = 2.0  # of the difference; a verdict needs a larger difference than this
FORMULA = (
    "Differences are over the seeds that both sides have, ± 2 SE. Verdict: worse or better where the difference "
    "exceeds 2 SE, else no difference shown. SE = √(s₁²/n₁ + s₂²/n₂) is the standard error of the difference of two "
    "independent means, s the standard deviation over n seeds (n − 1). A verdict needs n ≥ 3."
)


@dataclass(frozen=True)
class Estimate:
    """A quantity measured once per seed."""

    mean: float
    std: float  # over seeds, n - 1 in the denominator; NaN for one seed
    n: int

    @property
    def standard_error(self) -> float:
        """Of the mean: std / √n."""
        return self.std / math.sqrt(self.n)


def estimate(values: Iterable[float]) -> Estimate | None:
    """Mean and sample standard deviation; None if a value is NaN, since a mean over some seeds would mislead."""
    array = np.asarray(list(values), dtype=np.float64)
    if array.size == 0 or np.isnan(array).any():
        return None
    return Estimate(float(array.mean()), float(array.std(ddof=1)) if array.size > 1 else math.nan, array.size)


@dataclass(frozen=True)
class Difference:
    """A quantity minus that of a baseline."""

    mean: float
    standard_error: float  # NaN where a side has one seed
    n: int  # seeds of the side that has fewer

    def verdict(self, better: str) -> str:
        """`worse`, `better`, `no difference shown` or `too few seeds`, by FORMULA. better: as in metrics.Metric."""
        if self.n < MIN_SEEDS:
            return f"too few seeds ({self.n} of {MIN_SEEDS})"
        gain = -self.mean if better == "lower" else self.mean
        limit = STANDARD_ERRORS * self.standard_error
        return "better" if gain > limit else "worse" if gain < -limit else "no difference shown"


def difference(changed: Estimate, baseline: Estimate) -> Difference:
    error = math.sqrt(changed.standard_error**2 + baseline.standard_error**2)
    return Difference(changed.mean - baseline.mean, error, min(changed.n, baseline.n))


def mean_difference(found: Sequence[Difference]) -> Difference:
    """The mean over scenes, with the propagated standard error."""
    error = math.sqrt(sum(one.standard_error**2 for one in found)) / len(found)
    return Difference(float(np.mean([one.mean for one in found])), error, min(one.n for one in found))
