"""PSNR of schedules at their ends and at equal training time.

A faster schedule ends sooner, so final PSNR alone favours the slower one. Here each run's PSNR is interpolated from its
learning curve at the time at which the first of the compared runs ended.
"""

from __future__ import annotations

import math

import numpy as np
import pandas as pd

from pipeline.presentation.seed_statistics import estimate, over_seeds
from pipeline.presentation.table import Cell, Column, Row, Table, measured, number, text
from pipeline.report.read import scenes
from pipeline.report.tables.changed_settings import scene_settings
from pipeline.report.tables.footnotes import left_out_notes
from pipeline.runs.read.collect import Collection
from pipeline.runs.read.model_labels import requested


def equal_time(collection: Collection) -> Table | None:
    """A row per schedule and model, for scenes with at least two schedules with curves; None without rows."""
    columns = (
        Column("scene", "Scene", False),
        Column("ablation", "Model", False, fold=True),
        Column("train", "Schedule", False),
        Column("iterations", "Iterations"),
        Column("train_seconds", "Train s"),
        Column("final_psnr", "PSNR ↑ at the end"),
        Column("shared_seconds", "Equal s"),
        Column("shared_psnr", "PSNR ↑ at equal s"),
    )
    rows: list[Row] = []
    # Scenes at one size and with the same held-out views; others are not compared.
    curves = collection.curves.assign(
        settings=[", ".join(scene_settings(train)) for train in collection.curves["train"]]
    )
    for (scene, _), of_scene in _in_order(curves):
        for model in scenes.ablations_in_order(of_scene["ablation"].map(requested)):
            # Schedules are compared for one requested model: selection by validation is a part of the schedule.
            compared = of_scene[of_scene["ablation"].map(requested) == model]
            if compared["train"].nunique() < 2:
                continue
            seconds = float(compared.groupby("run")["train_seconds"].max().min())
            rows += [
                _row(collection.runs, scene, ablation, train, seconds, curve)
                for (train, ablation), curve in compared.groupby(["train", "ablation"], sort=True)
            ]
    if not rows:
        return None
    notes = (
        (
            "",
            "Equal s: training time at which the fastest run of the scene ended. PSNR is interpolated linearly there. "
            "Both are of the views that are evaluated during training (train.eval_views).",
        ),
        *left_out_notes(row.cells["ablation"].text for row in rows),
    )
    return Table("equal_time", "PSNR of schedules at equal training time", columns, tuple(rows), notes=notes)


def _in_order(curves: pd.DataFrame) -> list[tuple[tuple[str, str], pd.DataFrame]]:
    """((scene, its settings), their curves), the scenes in the usual order."""
    places = {scene: place for place, scene in enumerate(scenes.in_order(curves["scene"]))}
    return sorted(curves.groupby(["scene", "settings"]), key=lambda part: (places[part[0][0]], part[0][1]))


def _row(runs: pd.DataFrame, scene: str, ablation: str, train: str, seconds: float, curves: pd.DataFrame) -> Row:
    """One experiment, whose curves are read after `seconds` of training."""

    def mean(metric: str, decimals: int) -> Cell:
        return measured(over_seeds(runs, scene, ablation, train, metric), decimals)

    return Row(
        {
            "scene": text(scene),
            "ablation": text(ablation),
            "train": text(train),
            "iterations": mean("iterations", 0),
            "train_seconds": mean("train_seconds", 0),
            "final_psnr": measured(estimate(psnr_at(curve, math.inf) for _, curve in curves.groupby("run"))),
            "shared_seconds": number(seconds, 0),
            "shared_psnr": measured(estimate(psnr_at(curve, seconds) for _, curve in curves.groupby("run"))),
        }
    )


def psnr_at(curve: pd.DataFrame, seconds: float) -> float:
    """PSNR of one run after `seconds` of training, interpolated linearly; NaN before the first evaluation."""
    curve = curve.sort_values("train_seconds")
    return float(np.interp(seconds, curve["train_seconds"], curve["psnr"], left=np.nan))
