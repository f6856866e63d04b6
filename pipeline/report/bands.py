"""What a line of a training curve shows: mean and spread over seeds, and where training was still coarse."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd


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

    settings: run -> its settings. A time budget moves the schedule on as it does in training (pipeline/schedule.py).
    """
    return float(np.mean([_end_of_coarse(curve, settings[run], x) for run, curve in curves.groupby("run")]))


def _end_of_coarse(curve: pd.DataFrame, settings: Mapping[str, Any], x: str) -> float:
    until = max((step["until"] for step in settings.get("train.resolution_steps") or []), default=0.0)
    if not until:
        return 0.0
    curve = curve.sort_values("iteration")
    done = curve["iteration"] / settings["train.iterations"]
    if (budget := settings.get("train.time_budget_s")) is not None:
        done = np.maximum(done, curve["train_seconds"] / budget)
    return float(np.interp(until, [0.0, *done], [0.0, *curve[x]]))


def split_at(xs: np.ndarray, ys: np.ndarray, at: float) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
    """The parts of a line before and after `at`, each (xs, ys); they meet there. A part may be empty."""
    if at <= xs[0]:
        return (xs[:0], ys[:0]), (xs, ys)
    if at >= xs[-1]:
        return (xs, ys), (xs[:0], ys[:0])
    meeting, before = np.interp(at, xs, ys), xs < at
    after = xs > at
    return ((np.append(xs[before], at), np.append(ys[before], meeting)),
            (np.insert(xs[after], 0, at), np.insert(ys[after], 0, meeting)))
