"""Statistics over seeds: mean, standard deviation, standard error, and the verdict on an ablation."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import pandas as pd

from pipeline.runs.read.model_labels import baseline_of

MIN_SEEDS = 3  # with fewer the standard error is too uncertain
STANDARD_ERRORS = 2.0  # of the difference; a verdict needs a larger difference than this
TOO_FEW_SEEDS = "too few seeds"
FORMULA = (
    "Worse: mean(full) − mean(ablation) > 2 SE. Better: mean(ablation) − mean(full) > 2 SE. Otherwise no difference is "
    "shown. SE = √(s²(full)/n(full) + s²(ablation)/n(ablation)) is the standard error of the difference of two "
    "independent means. s is the standard deviation over seeds (n − 1), n the number of seeds. A verdict needs n ≥ 3."
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


def select(runs: pd.DataFrame, scene: str, ablation: str, train: str) -> pd.DataFrame:
    """The seeds of one experiment."""
    return runs[(runs["scene"] == scene) & (runs["ablation"] == ablation) & (runs["train"] == train)]


def over_seeds(runs: pd.DataFrame, scene: str, ablation: str, train: str, metric: str) -> Estimate | None:
    """`metric` (a column such as `final.psnr`) of one experiment; None without runs or if one lacks the metric."""
    return estimate(select(runs, scene, ablation, train)[metric])


def over_scenes(
    runs: pd.DataFrame, scenes: Iterable[str], ablation: str, train: str, metric: str
) -> tuple[Estimate | None, int]:
    """Mean over `scenes` of the per-scene means, and the number of scenes with runs.

    The std is that of the per-seed means over scenes, for the seeds that every scene has (NaN with fewer than two).
    """
    chosen = runs[(runs["ablation"] == ablation) & (runs["train"] == train) & runs["scene"].isin(list(scenes))]
    if chosen.empty:
        return None, 0
    if chosen[metric].isna().any():
        return None, chosen["scene"].nunique()
    scene_by_seed = chosen.pivot_table(index="scene", columns="seed", values=metric)
    mean = float(scene_by_seed.mean(axis=1).mean())
    common = scene_by_seed.dropna(axis=1).mean(axis=0)
    std = float(common.std(ddof=1)) if len(common) > 1 else math.nan
    return Estimate(mean, std, max(len(common), 1)), len(scene_by_seed)


@dataclass(frozen=True)
class Verdict:
    """An ablation compared with its baseline on one scene, schedule and metric, where higher is better."""

    full: Estimate
    ablation: Estimate
    difference: float  # mean(full) - mean(ablation)
    standard_error: float  # of the difference; NaN where a side has one seed

    @property
    def word(self) -> str:
        """`worse`, `better`, `no difference shown` or TOO_FEW_SEEDS."""
        if min(self.full.n, self.ablation.n) < MIN_SEEDS:
            return TOO_FEW_SEEDS
        if self.difference > STANDARD_ERRORS * self.standard_error:
            return "worse"
        if -self.difference > STANDARD_ERRORS * self.standard_error:
            return "better"
        return "no difference shown"


def compare(full: Estimate, ablation: Estimate) -> Verdict:
    """The verdict by FORMULA. Where lower is better, pass negated values."""
    return Verdict(
        full, ablation, full.mean - ablation.mean, math.sqrt(full.standard_error**2 + ablation.standard_error**2)
    )


def verdict(runs: pd.DataFrame, scene: str, ablation: str, train: str, metric: str) -> Verdict | None:
    """A model compared with its baseline (model_labels.baseline_of); None unless both have runs with this metric."""
    if (baseline := baseline_of(ablation)) is None:
        return None
    full = over_seeds(runs, scene, baseline, train, metric)
    other = over_seeds(runs, scene, ablation, train, metric)
    return compare(full, other) if full and other else None


def trains(runs: pd.DataFrame, scenes: Iterable[str], ablation: str | None = None) -> list[str]:
    """The sorted schedules (`paper`, `fast`, …) with runs on any of `scenes`; with `ablation`, of that model."""
    chosen = runs[runs["scene"].isin(list(scenes))]
    if ablation is not None:
        chosen = chosen[chosen["ablation"] == ablation]
    return sorted(chosen["train"].unique())
