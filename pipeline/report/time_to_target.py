"""CPU seconds until a target PSNR of a scene is reached, by at least 3 of 5 seeds, as AlgoPerf counts.

A seed that never reaches it takes forever; the time is the median over the seeds. Of D-NeRF the paper prints the mean
of eight scenes alone: a seed's curve is the mean PSNR where each scene was trained for as long. The target of a single
scene is what the authors' program reached on it.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterator
from dataclasses import dataclass

import pandas as pd

from pipeline.presentation.table import NOT_MEASURED, Cell, Column, Row, Table, number
from pipeline.report.mean_curves import mean_curve
from pipeline.report.paper_table import read
from pipeline.report.run_table import FOLDED, HEADERS, protocol_notes
from pipeline.report.runs import Collection
from pipeline.report.time_to_psnr import seconds_to

SEEDS, REACHED = 5, 3
_HEADS = ("protocol", "recipe_label", "model", "machine")
_NOTES = (
    f"CPU seconds of training, median over the seeds. A target counts if {REACHED} of {SEEDS} seeds reach it.",
    "Of runs that did not record CPU seconds: seconds of the clock × threads.",
    "Targets are the paper's: mean of the channels' PSNRs, best on test. Ours is of the image, which is never higher.",
    "Of a D-NeRF scene: what the authors' program reached on our images, PSNR of the image, best on test.",
    "D-NeRF: the mean of eight scenes, each trained for as long; CPU seconds are those of one scene.",
    "Roof: what one thread of the machine achieved right after training. Work: CPU seconds × multiply-adds a second.",
)


@dataclass(frozen=True)
class TimeToTarget:
    """A row per target, protocol, recipe, model and machine, of runs on CPUs."""

    def build(self, collection: Collection) -> Table | None:
        runs, curves = collection.runs, collection.curves
        runs = runs[runs["run"].isin(curves["run"]) & runs["threads"].notna() & (runs["gpu"] == "")]
        rows = [row for line in read("targets") for row in _rows(line, runs, curves)]
        columns = (
            Column("target", "Target", False),
            Column("psnr", "PSNR, dB"),
            *(Column(name, HEADERS[name], False, fold=name in FOLDED) for name in _HEADS),
            Column("seconds", "CPU seconds"),
            Column("reached", "Seeds that reached it"),
            Column("operations", "Roof, G multiply-adds/s"),
            Column("bytes", "Roof, GB/s"),
            Column("work", "Work, T multiply-adds"),
        )
        title = "Time to a target PSNR"
        notes = tuple(("", note) for note in (*protocol_notes(runs["protocol"]), *_NOTES))
        return Table("time_to_target", title, columns, tuple(rows), notes=notes) if rows else None


def _rows(line: dict[str, str], runs: pd.DataFrame, curves: pd.DataFrame) -> Iterator[Row]:
    """Of one target."""
    wanted = line["scenes"].split()
    for heads, group in runs[runs["scene"].isin(wanted)].groupby(list(_HEADS), sort=True):
        whole = [seed for _, seed in group.groupby("seed") if set(seed["scene"]) == set(wanted)]
        if not whole:
            continue
        times = [seconds_to(mean_curve(seed, curves), float(line["psnr"]), "cpu_seconds") for seed in whole]
        rate, bandwidth = (group[name].median() / 1e9 for name in ("multiply_adds_per_s", "bytes_per_s"))
        seconds = time_of(times)
        cells = {
            "target": Cell(line["target"]),
            "psnr": Cell(line["psnr"], float(line["psnr"])),
            **{name: Cell(str(value)) for name, value in zip(_HEADS, heads)},
            "seconds": Cell(seconds) if isinstance(seconds, str) else number(seconds, 0),
            "reached": Cell(f"{sum(time is not None for time in times)} of {len(times)}"),
            "operations": number(rate, 0),
            "bytes": number(bandwidth, 1),
            "work": NOT_MEASURED if isinstance(seconds, str) else number(seconds * rate / 1e3, 1),
        }
        yield Row(cells)


def time_of(times: list[float | None]) -> float | str:
    """The median of the seeds' times, None for never; in words where there is none."""
    if len(times) < SEEDS:
        return f"fewer than {SEEDS} seeds"
    middle = statistics.median_high([math.inf if time is None else time for time in times])
    return middle if math.isfinite(middle) else "not reached"
