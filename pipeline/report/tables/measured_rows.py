"""Rows and cells with our results for the paper's tables."""

from __future__ import annotations

from collections.abc import Callable

import pandas as pd

from pipeline.presentation.seed_statistics import over_scenes, over_seeds, select, trains
from pipeline.presentation.table import NO_RUN, Cell, Row, measured, text
from pipeline.runs.read.run_files import PROTOCOLS

_PROTOCOL_NAME = {"final": "final", "best_on_test": "best on test"}


def our_rows(schedules: list[str], cells_of: Callable[[str, str], dict[str, Cell]]) -> list[Row]:
    """A `final` and a `best on test` row for each schedule. cells_of: (schedule, protocol) -> cells."""
    return [
        Row({"method": text(f"Ours, {train}, {_PROTOCOL_NAME[protocol]}"), **cells_of(train, protocol)})
        for train in schedules
        for protocol in PROTOCOLS
    ]


def our_mean_rows(runs: pd.DataFrame, scenes: tuple[str, ...], metric_of: dict[str, tuple[str, int]]) -> list[Row]:
    """Rows of means of `full` over `scenes`. metric_of: column key -> (metric, decimals)."""

    def cells(train: str, protocol: str) -> dict[str, Cell]:
        means = {
            key: over_scenes(runs, scenes, "full", train, f"{protocol}.{metric}")
            for key, (metric, _) in metric_of.items()
        }
        count = max(n for _, n in means.values())
        covered = str(len(scenes)) if count == len(scenes) else f"mean of {count} of {len(scenes)}"
        return {"scenes": text(covered), **{key: measured(means[key][0], metric_of[key][1]) for key in metric_of}}

    return our_rows(trains(runs, scenes, "full"), cells)


def scene_cell(runs: pd.DataFrame, scene: str, ablation: str, train: str, metric: str, decimals: int = 2) -> Cell:
    """Mean ± std over seeds; empty without a run, n/a where a run lacks the metric."""
    if select(runs, scene, ablation, train).empty:
        return NO_RUN
    return measured(over_seeds(runs, scene, ablation, train, metric), decimals)
