"""Mean and standard deviation of learning curves over seeds; where coarse-resolution training ends."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from pipeline.report.runs import is_number


def mean_and_std(curves: pd.DataFrame, x: str, y: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(x, mean, std) over the runs of `curves`, in the range of `x` that all runs cover.

    Seeds are not evaluated at the same second, so each run is interpolated linearly, at every x at which any run was
    evaluated. std has n - 1 in the denominator and is zero for a single run.
    """
    runs = [(g[x].to_numpy(float), g[y].to_numpy(float)) for _, g in curves.sort_values(x).groupby("run")]
    low, high = max(xs[0] for xs, _ in runs), min(xs[-1] for xs, _ in runs)
    if len(runs) == 1 or high <= low:
        xs, ys = runs[0]
        return xs, ys, np.zeros_like(ys)
    grid = np.unique(np.concatenate([xs for xs, _ in runs]))
    grid = grid[(grid >= low) & (grid <= high)]
    values = np.stack([np.interp(grid, xs, ys) for xs, ys in runs])
    return grid, values.mean(axis=0), values.std(axis=0, ddof=1)


def end_of_coarse(curves: pd.DataFrame, settings: Mapping[str, Mapping[str, Any]], x: str) -> float:
    """The x (train_seconds or iteration) at which full-resolution training begins, mean over runs; 0: at the start.

    settings: run -> its settings. A time budget advances the schedule as in pipeline/training/schedule.py.
    """
    return float(np.mean([_end_of_coarse(curve, settings[run], x) for run, curve in curves.groupby("run")]))


def _end_of_coarse(curve: pd.DataFrame, settings: Mapping[str, Any], x: str) -> float:
    steps = settings.get("train.resolution_steps")
    steps = [step for step in steps if isinstance(step, dict)] if isinstance(steps, list) else []
    untils = [_positive(step.get("until")) for step in steps]
    until, iterations = max(untils, default=0.0), _positive(settings.get("train.iterations"))
    if not until or not iterations:
        return 0.0
    curve = curve.sort_values("iteration")
    progress = curve["iteration"] / iterations
    if budget := _positive(settings.get("train.time_budget_s")):
        progress = np.maximum(progress, curve["train_seconds"] / budget)
    return float(np.interp(until, [0.0, *progress], [0.0, *curve[x]]))


def _positive(value: Any) -> float:
    """`value` if it is a positive finite number, else 0: config.yaml may have been edited by hand."""
    return float(value) if is_number(value) and value > 0 else 0.0


def split_at(xs: np.ndarray, ys: np.ndarray, at: float) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
    """The parts of a curve before and after x = `at`, each (xs, ys) with the point at `at`; one may be empty."""
    if at <= xs[0]:
        return (xs[:0], ys[:0]), (xs, ys)
    if at >= xs[-1]:
        return (xs, ys), (xs[:0], ys[:0])
    y_at, before, after = np.interp(at, xs, ys), xs < at, xs > at
    return (
        (np.append(xs[before], at), np.append(ys[before], y_at)),
        (np.insert(xs[after], 0, at), np.insert(ys[after], 0, y_at)),
    )
