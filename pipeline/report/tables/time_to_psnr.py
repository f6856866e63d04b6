"""Training time until a learning curve first reaches a given PSNR.

A level is reached at the first evaluation at or above it. The time is interpolated linearly between that evaluation and
the one before. A later decrease is ignored.
"""

from __future__ import annotations

import math

import pandas as pd

from pipeline.presentation.seed_statistics import estimate
from pipeline.presentation.table import Cell, Column, Row, Table, measured, text
from pipeline.report.read import scenes
from pipeline.report.tables.footnotes import left_out_notes
from pipeline.runs.read.collect import Collection

LEVELS_BELOW = (4, 2, 1, 0)  # default levels: dB below the highest PSNR of the scene, rounded down


def time_to_psnr(collection: Collection, levels: tuple[float, ...] = ()) -> Table | None:
    """A row per scene, model, schedule and level; None without rows.

    levels: in dB, for all scenes. Without levels: those of LEVELS_BELOW, for scenes with two models or schedules.
    """
    columns = (
        Column("scene", "Scene", False),
        Column("ablation", "Model", False, fold=True),
        Column("train", "Schedule", False, fold=True),
        Column("level", "PSNR reached"),
        Column("seconds", "Train s"),
        Column("reached", "Seeds that reached it"),
    )
    curves, rows = collection.curves, []
    for scene in scenes.in_order(curves["scene"]):
        of_scene = curves[curves["scene"] == scene]
        if not levels and len(of_scene.drop_duplicates(["ablation", "train"])) < 2:
            continue
        for level in levels or levels_of(of_scene):
            for ablation in scenes.ablations_in_order(of_scene["ablation"]):
                of_ablation = of_scene[of_scene["ablation"] == ablation]
                for train, seeds in of_ablation.groupby("train", sort=True):
                    seconds = [seconds_to(run, level) for _, run in seeds.groupby("run")]
                    rows.append(
                        Row(
                            {
                                "scene": text(scene),
                                "ablation": text(ablation),
                                "train": text(train),
                                "level": Cell(f"{level:g} dB", level),
                                **_cells(seconds),
                            }
                        )
                    )
    if not rows:
        return None
    note = (
        "Train s: mean over the seeds that reached the PSNR, interpolated between evaluations. Evaluations are at full "
        "resolution, so PSNR is low while training is at a coarse resolution."
    )
    return Table(
        "time_to_psnr",
        "Training time to a given PSNR",
        columns,
        tuple(rows),
        notes=(("", note), *left_out_notes(row.cells["ablation"].text for row in rows)),
    )


def levels_of(curves: pd.DataFrame) -> tuple[float, ...]:
    """The default levels of one scene in dB, ascending."""
    highest = math.floor(curves["psnr"].max())
    return tuple(float(highest - below) for below in LEVELS_BELOW)


def seconds_to(curve: pd.DataFrame, level: float) -> float | None:
    """Training seconds at which one run first reaches `level` dB; None if it never does."""
    curve = curve.sort_values("train_seconds")
    before = None
    for seconds, psnr in zip(curve["train_seconds"], curve["psnr"]):
        if psnr >= level:
            if before is None:
                return float(seconds)
            fraction = (level - before[1]) / (psnr - before[1])
            return float(before[0] + fraction * (seconds - before[0]))
        before = (seconds, psnr)
    return None


def _cells(seconds: list[float | None]) -> dict[str, Cell]:
    reached = [s for s in seconds if s is not None]
    return {
        "seconds": measured(estimate(reached), 1) if reached else text("never reached"),
        "reached": text(f"{len(reached)} of {len(seconds)}"),
    }
