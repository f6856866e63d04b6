"""Training time until a learning curve first reaches a given PSNR.

A level is reached at the first evaluation at or above it. The time is interpolated linearly between that evaluation and
the one before. A later decrease is ignored.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import pandas as pd

from pipeline.presentation.statistics import estimate
from pipeline.presentation.table import Cell, Column, Row, Table, measured
from pipeline.report import scenes
from pipeline.report.run_table import FOLDED, HEADERS
from pipeline.report.runs import Collection

LEVELS_BELOW = (4, 2, 1, 0)  # default levels: dB below the highest PSNR of the scene, rounded down
_HEADS = ("scene_label", "protocol", "model", "recipe_label")
_NOTE = (
    "Training: mean over the seeds that reached the PSNR, interpolated between evaluations. Evaluations are at full "
    "resolution, so PSNR is low while training is at a coarse resolution."
)


@dataclass(frozen=True)
class TimeToPsnr:
    """A row per scene, model, recipe and level. levels: in dB, for all scenes; without them those of LEVELS_BELOW, for
    scenes with two models or recipes."""

    levels: tuple[float, ...] = ()

    def build(self, collection: Collection) -> Table | None:
        curves = collection.curves
        rows = [
            row
            for scene in scenes.in_order(curves["scene_label"])
            for row in self._rows(curves[curves["scene_label"] == scene])
        ]
        columns = (
            *(Column(name, HEADERS[name], False, fold=name in FOLDED) for name in _HEADS),
            Column("level", "PSNR reached"),
            Column("seconds", "Training, s"),
            Column("reached", "Seeds that reached it"),
        )
        title = "Training time to a given PSNR"
        return Table("time_to_psnr", title, columns, tuple(rows), notes=(("", _NOTE),)) if rows else None

    def _rows(self, curves: pd.DataFrame) -> list[Row]:
        """Of one scene."""
        if not self.levels and len(curves.drop_duplicates(["model", "recipe_label"])) < 2:
            return []
        rows = []
        for level in self.levels or levels_of(curves):
            for model in scenes.models_in_order(curves["model"]):
                for _, seeds in curves[curves["model"] == model].groupby("recipe_label", sort=True):
                    seconds = [seconds_to(run, level) for _, run in seeds.groupby("run")]
                    reached = [value for value in seconds if value is not None]
                    cells = {name: Cell(seeds[name].iloc[0]) for name in _HEADS}
                    cells |= {
                        "level": Cell(f"{level:g} dB", level),
                        "seconds": measured(estimate(reached), 1) if reached else Cell("never reached"),
                        "reached": Cell(f"{len(reached)} of {len(seconds)}"),
                    }
                    rows.append(Row(cells))
        return rows


def levels_of(curves: pd.DataFrame) -> tuple[float, ...]:
    """The default levels of one scene in dB, ascending."""
    highest = math.floor(curves["psnr"].max())
    return tuple(float(highest - below) for below in LEVELS_BELOW)


def seconds_to(curve: pd.DataFrame, level: float, clock: str = "train_seconds") -> float | None:
    """Seconds, of the column `clock`, at which one run first reaches `level` dB; None if it never does."""
    curve = curve.sort_values(clock)
    before = None
    for seconds, psnr in zip(curve[clock], curve["psnr"]):
        if psnr >= level:
            if before is None:
                return float(seconds)
            fraction = (level - before[1]) / (psnr - before[1])
            return float(before[0] + fraction * (seconds - before[0]))
        before = (seconds, psnr)
    return None
