"""Schedules of one scene compared at equal iterations' end and at equal training time.

A schedule that does less an iteration ends sooner; what it would lose to another is only seen at the same second. So
each run's PSNR is read off its training curve at the time when the first of the compared runs had ended.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from . import scenes
from .aggregate import estimate, over_seeds
from .collect import Collection
from .table import Cell, Column, Row, Table, measured, number, text


def equal_time(collection: Collection) -> Table | None:
    """A row a schedule, where a scene and ablation has at least two with curves; None if there is no such scene."""
    columns = (
        Column("scene", "Scene", False),
        Column("ablation", "Ablation", False),
        Column("train", "Schedule", False),
        Column("iterations", "Iterations"),
        Column("train_seconds", "Train s"),
        Column("final_psnr", "PSNR ↑ at its end"),
        Column("shared_seconds", "Shared s"),
        Column("shared_psnr", "PSNR ↑ at the shared second"),
    )
    runs, curves, rows = collection.runs, collection.curves, []
    for scene in scenes.in_order(curves["scene"]):
        for ablation in scenes.ablations_in_order(curves.loc[curves["scene"] == scene, "ablation"]):
            compared = curves[(curves["scene"] == scene) & (curves["ablation"] == ablation)]
            names = sorted(compared["train"].unique())
            if len(names) < 2:
                continue
            shared = float(compared.groupby("run")["train_seconds"].max().min())
            for name in names:
                def over(metric: str, decimals: int, name: str = name) -> Cell:
                    return measured(over_seeds(runs, scene, ablation, name, metric), decimals)

                mine = compared[compared["train"] == name]
                at_shared = estimate(psnr_at(run, shared) for _, run in mine.groupby("run"))
                rows.append(Row({
                    "scene": text(scene), "ablation": text(ablation), "train": text(name),
                    "iterations": over("iterations", 0), "train_seconds": over("train_seconds", 0),
                    "final_psnr": over("final.psnr", 2), "shared_seconds": number(shared, 0),
                    "shared_psnr": measured(at_shared)}))
    if not rows:
        return None
    note = "Shared s: when the quickest of the scene's runs had ended; PSNR there is read off the curves, linearly."
    return Table("equal_time", "Schedules at equal time", columns, tuple(rows), notes=(("", note),))


def psnr_at(curve: pd.DataFrame, seconds: float) -> float:
    """PSNR of one run's curve at a training second, linear between evaluations; NaN before the first."""
    curve = curve.sort_values("train_seconds")
    return float(np.interp(seconds, curve["train_seconds"], curve["psnr"], left=np.nan))
