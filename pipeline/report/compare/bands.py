"""What a line of a training curve shows: mean and spread over seeds, and where training was still coarse."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from pipeline.runs.read.collect import LARGEST_NUMBER


def band(curves: pd.DataFrame, x: str, y: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(x, mean, std) over runs where every run has values; each run is interpolated linearly.

    Seeds are not evaluated at the same second, so their values can only be compared in between. At every evaluation of
    any of them inside the common range; the mean is exact there and between. The std (n - 1) is zero for a single run.
    """
    runs = [(g[x].to_numpy(float), g[y].to_numpy(float)) for _, g in curves.sort_values(x).groupby("run")]
    low, high = max(xs[0] for xs, _ in runs), min(xs[-1] for xs, _ in runs)
    if len(runs) == 1 or high <= low:
        xs, ys = runs[0]
        return xs, ys, np.zeros_like(ys)
    every = np.unique(np.concatenate([xs for xs, _ in runs]))
    grid = every[(every >= low) & (every <= high)]
    values = np.stack([np.interp(grid, xs, ys) for xs, ys in runs])
    return grid, values.mean(axis=0), values.std(axis=0, ddof=1)


def end_of_coarse(curves: pd.DataFrame, settings: Mapping[str, Mapping[str, Any]], x: str) -> float:
    """Where on `x` (train_seconds or iteration) the runs began to train at full resolution, mean over them; 0: at once.

    settings: run -> its settings. A time budget moves the schedule on as it does in training (pipeline/training/schedule.py).
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
    done = curve["iteration"] / iterations
    if budget := _positive(settings.get("train.time_budget_s")):
        done = np.maximum(done, curve["train_seconds"] / budget)
    return float(np.interp(until, [0.0, *done], [0.0, *curve[x]]))


def _positive(value: Any) -> float:
    """0 for what is no such number: config.yaml is a file that anybody may have edited."""
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return float(value) if is_number and 0 < value < LARGEST_NUMBER else 0.0


def split_at(xs: np.ndarray, ys: np.ndarray, at: float) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
    """The parts of a line before and after `at`, each (xs, ys); they meet there. A part may be empty."""
    if at <= xs[0]:
        return (xs[:0], ys[:0]), (xs, ys)
    if at >= xs[-1]:
        return (xs, ys), (xs[:0], ys[:0])
    meeting, before = np.interp(at, xs, ys), xs < at
    after = xs > at
    return (
        (np.append(xs[before], at), np.append(ys[before], meeting)),
        (np.insert(xs[after], 0, at), np.insert(ys[after], 0, meeting)),
    )
