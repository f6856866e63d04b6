"""Error against run time over a family of scenes: curves of a recipe averaged where each scene was trained for as long.

PSNR is -10 log10 of the MSE, so that its mean over scenes is the mean logarithm of their errors.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from pipeline.report import scenes
from pipeline.report.runs import CURVE_COLUMNS, IDENTITY, Collection


def cpu_seconds(curve: pd.DataFrame, threads: float) -> pd.Series:
    """Of training, all threads; of runs that did not record them seconds of the clock × threads."""
    return curve["cpu_seconds"].fillna(curve["train_seconds"] * threads)


def mean_curve(runs: pd.DataFrame, curves: pd.DataFrame, columns: Sequence[str] = ("psnr",)) -> pd.DataFrame:
    """`columns` over `cpu_seconds` of a seed's runs, one a scene: the mean where each was trained for as long. A run
    that has ended keeps its last value."""
    own = []
    for run, threads in zip(runs["run"], runs["threads"]):
        curve = curves[curves["run"] == run].sort_values("iteration")
        own.append((cpu_seconds(curve, threads).to_numpy(float), curve))
    times = np.unique(np.concatenate([seconds for seconds, _ in own]))
    times = times[times >= max(seconds[0] for seconds, _ in own)]
    means = {
        name: np.mean([np.interp(times, seconds, curve[name].to_numpy(float)) for seconds, curve in own], axis=0)
        for name in columns
    }
    return pd.DataFrame({"cpu_seconds": times, **means})


def with_means(collection: Collection) -> Collection:
    """The collection with one more scene a family: the means of the recipes that trained all its scenes on CPUs."""
    found = list(_means(collection))
    if not found:
        return collection
    settings: dict[str, dict] = {run: {} for curve in found for run in curve["run"].unique()}
    curves = pd.concat([collection.curves, *found], ignore_index=True)
    return replace(collection, curves=curves, settings={**collection.settings, **settings})


def _means(collection: Collection) -> Iterator[pd.DataFrame]:
    runs = collection.runs
    runs = runs[runs["run"].isin(collection.curves["run"]) & runs["threads"].notna() & (runs["gpu"] == "")]
    family = [scenes.family(*row) for row in runs[["scene", "capture"]].itertuples(index=False)]
    for (name, protocol), of_family in runs.groupby([pd.Series(family, runs.index), "protocol"]):
        labels = set(of_family["scene_label"])
        if len(labels) < 2:
            continue
        title = f"{scenes.FAMILIES[name]}, mean of {len(labels)}"
        for key, seed in of_family.groupby([name for name in IDENTITY if name != "scene_label"]):
            if set(seed["scene_label"]) == labels:
                curve = mean_curve(seed, collection.curves, ("psnr", "ssim", "n_gaussians"))
                identity = dict(zip([name for name in IDENTITY if name != "scene_label"], key))
                run = f"{title}, {protocol}: " + ", ".join(map(str, key))
                empty = {name: np.nan for name in CURVE_COLUMNS if name not in curve}
                yield curve.assign(run=run, scene_label=title, **identity, **empty)
