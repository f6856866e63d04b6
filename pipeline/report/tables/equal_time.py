"""Schedules of one scene compared at equal iterations' end and at equal training time.

A schedule that does less an iteration ends sooner; what it would lose to another is only seen at the same second. So
each run's PSNR is read off its training curve at the time when the first of the compared runs had ended.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from pipeline.presentation.seeds import estimate, over_seeds
from pipeline.presentation.table import Cell, Column, Row, Table, measured, number, text
from pipeline.report.read import scenes
from pipeline.report.tables.our_rows import left_out_notes
from pipeline.runs.read.collect import Collection
from pipeline.runs.read.model_labels import asked


def equal_time(collection: Collection) -> Table | None:
    """A row a schedule and model, where a scene and ablation has at least two schedules with curves; else None."""
    columns = (
        Column("scene", "Scene", False),
        Column("ablation", "Model", False, fold=True),
        Column("train", "Schedule", False),
        Column("iterations", "Iterations"),
        Column("train_seconds", "Train s"),
        Column("final_psnr", "PSNR ↑ at its end"),
        Column("shared_seconds", "Shared s"),
        Column("shared_psnr", "PSNR ↑ at the shared second"),
    )
    runs, curves, rows = collection.runs, collection.curves, []
    for scene in scenes.in_order(curves["scene"]):
        of_scene = curves[curves["scene"] == scene]
        for wanted in scenes.ablations_in_order(of_scene["ablation"].map(asked)):
            # What selection leaves out is a schedule's doing: schedules are compared by what they were asked for.
            compared = of_scene[of_scene["ablation"].map(asked) == wanted]
            if compared["train"].nunique() < 2:
                continue
            shared = float(compared.groupby("run")["train_seconds"].max().min())
            for (name, ablation), mine in compared.groupby(["train", "ablation"], sort=True):

                def over(metric: str, decimals: int, name: str = name, ablation: str = ablation) -> Cell:
                    return measured(over_seeds(runs, scene, ablation, name, metric), decimals)

                at_shared = estimate(psnr_at(run, shared) for _, run in mine.groupby("run"))
                rows.append(
                    Row(
                        {
                            "scene": text(scene),
                            "ablation": text(ablation),
                            "train": text(name),
                            "iterations": over("iterations", 0),
                            "train_seconds": over("train_seconds", 0),
                            "final_psnr": over("final.psnr", 2),
                            "shared_seconds": number(shared, 0),
                            "shared_psnr": measured(at_shared),
                        }
                    )
                )
    if not rows:
        return None
    note = "Shared s: when the quickest of the scene's runs had ended; PSNR there is read off the curves, linearly."
    notes = (("", note), *left_out_notes(row.cells["ablation"].text for row in rows))
    return Table("equal_time", "Schedules at equal time", columns, tuple(rows), notes=notes)


def psnr_at(curve: pd.DataFrame, seconds: float) -> float:
    """PSNR of one run's curve at a training second, linear between evaluations; NaN before the first."""
    curve = curve.sort_values("train_seconds")
    return float(np.interp(seconds, curve["train_seconds"], curve["psnr"], left=np.nan))
