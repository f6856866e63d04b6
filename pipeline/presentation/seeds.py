"""Mean ± standard deviation over seeds, standard errors, and the verdict on an ablation."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import pandas as pd

from pipeline.runs.read.model_labels import reference

MIN_SEEDS = 3  # fewer give no usable standard error
STANDARD_ERRORS = 2.0  # an ablation is worse when it is so many standard errors below `full`
FORMULA = (
    "An ablation is worse than full when mean(full) − mean(ablation) > 2 SE, with "
    "SE = √(s²(full)/n(full) + s²(ablation)/n(ablation)), the standard error of the difference of two "
    "independent means; s is the standard deviation over seeds (n − 1) and n ≥ 3 the number of seeds."
)


@dataclass(frozen=True)
class Estimate:
    """A quantity measured once per seed."""

    mean: float
    std: float  # over seeds, n - 1 in the denominator; NaN for one seed
    n: int

    @property
    def standard_error(self) -> float:
        """std / √n: how far the mean itself is likely to be off."""
        return self.std / math.sqrt(self.n)


def estimate(values: Iterable[float]) -> Estimate | None:
    """Mean and sample standard deviation; None if any seed lacks the value (a partial mean would mislead)."""
    array = np.asarray(list(values), dtype=np.float64)
    if array.size == 0 or np.isnan(array).any():
        return None
    return Estimate(float(array.mean()), float(array.std(ddof=1)) if array.size > 1 else math.nan, array.size)


def select(runs: pd.DataFrame, scene: str, ablation: str, train: str) -> pd.DataFrame:
    """The seeds of one experiment."""
    return runs[(runs["scene"] == scene) & (runs["ablation"] == ablation) & (runs["train"] == train)]


def over_seeds(runs: pd.DataFrame, scene: str, ablation: str, train: str, metric: str) -> Estimate | None:
    """`metric` (a column such as `final.psnr`) of one experiment; None without runs or if a seed lacks it."""
    return estimate(select(runs, scene, ablation, train)[metric])


def over_scenes(
    runs: pd.DataFrame, scenes: Iterable[str], ablation: str, train: str, metric: str
) -> tuple[Estimate | None, int]:
    """Mean over `scenes` of the per-scene means, and how many of them had runs.

    The std is that of the per-seed means over scenes, over the seeds that every scene has (NaN with fewer
    than two).
    """
    mine = runs[(runs["ablation"] == ablation) & (runs["train"] == train) & runs["scene"].isin(list(scenes))]
    if mine.empty:
        return None, 0
    if mine[metric].isna().any():
        return None, mine["scene"].nunique()
    scene_by_seed = mine.pivot_table(index="scene", columns="seed", values=metric)
    mean = float(scene_by_seed.mean(axis=1).mean())
    common = scene_by_seed.dropna(axis=1).mean(axis=0)
    std = float(common.std(ddof=1)) if len(common) > 1 else math.nan
    return Estimate(mean, std, max(len(common), 1)), len(scene_by_seed)


@dataclass(frozen=True)
class Verdict:
    """Is an ablation worse than `full` on one scene, under one schedule, for one metric (more is better)?"""

    full: Estimate
    ablation: Estimate
    difference: float  # mean(full) - mean(ablation); positive: the ablation is worse
    standard_error: float  # of that difference; NaN where a side has one seed

    @property
    def word(self) -> str:
        """`worse`, `better`, `no difference shown` or `too few seeds`."""
        if min(self.full.n, self.ablation.n) < MIN_SEEDS:
            return "too few seeds"
        if self.difference > STANDARD_ERRORS * self.standard_error:
            return "worse"
        if -self.difference > STANDARD_ERRORS * self.standard_error:
            return "better"
        return "no difference shown"


def compare(full: Estimate, ablation: Estimate) -> Verdict:
    """See FORMULA."""
    return Verdict(
        full, ablation, full.mean - ablation.mean, math.sqrt(full.standard_error**2 + ablation.standard_error**2)
    )


def verdict(runs: pd.DataFrame, scene: str, ablation: str, train: str, metric: str) -> Verdict | None:
    """A model against the one it is compared with (models.reference); None unless both have runs with this metric."""
    if (whole := reference(ablation)) is None:
        return None
    full = over_seeds(runs, scene, whole, train, metric)
    other = over_seeds(runs, scene, ablation, train, metric)
    return compare(full, other) if full and other else None


def trains(runs: pd.DataFrame, scenes: Iterable[str], ablation: str | None = None) -> list[str]:
    """The schedules (`paper`, `fast`, …) that ran on any of `scenes`, sorted."""
    mine = runs[runs["scene"].isin(list(scenes))]
    if ablation is not None:
        mine = mine[mine["ablation"] == ablation]
    return sorted(mine["train"].unique())
