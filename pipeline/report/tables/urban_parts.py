"""What each part of an urban model is worth: runs with one change beside the unchanged ones, per driving log.

A change is a setting (`scene.background_model=none`) or a model of conf/ablation (`static`, with the schedule's static
overrides). Changes of the scene belong to the scene, as in changed_settings.py. Only common seeds are compared.
"""

from __future__ import annotations

import math

import pandas as pd

from pipeline.presentation.seed_statistics import STANDARD_ERRORS, compare, estimate
from pipeline.presentation.table import NOT_MEASURED, Cell, Column, Row, Table, number, text
from pipeline.report.read import scenes
from pipeline.report.tables.footnotes import held_out_notes
from pipeline.report.tables.urban_table import is_urban
from pipeline.runs.read.collect import Collection
from pipeline.runs.read.run_names import file_name, parts_of, with_parts
from pipeline.runs.read.variants import VALIDATION

UNCHANGED, MODEL = "none", "full"  # of the changes; of the ablations
OF_STATIC = ("scene.", "init.", "depth.")  # what the static overrides of schedules never change
MIN_CHANGES = 2  # a single one is compared in other tables
METRICS = {  # column -> (metric, header, decimals)
    "psnr": ("final.psnr", "PSNR ↑", 2),
    "psnr_moving": ("final.psnr_moving", "PSNR ↑ moving", 2),
    "ssim": ("final.ssim", "SSIM ↑", 3),
    "lidar_error": ("final.lidar_error_median", "Depth error ↓, %", 2),
    "flow_error": ("final.flow_error", "Flow error ↓, %", 1),
    "train_seconds": ("train_seconds", "Train s ↓", 0),
}
PERCENT = ("lidar_error", "flow_error")
NOTE = (
    "",
    f"Change none: the mean over seeds. Other rows: change − none. ±: {STANDARD_ERRORS:.0f} standard errors of the "
    "mean or of the difference; none with one seed. In the CSV _std is one standard error. Depth error: median of "
    "|z − LiDAR| / LiDAR on held-out sweeps. Flow error: share of the true motion's length, where it is known.",
)


def urban_parts(collection: Collection) -> list[Table]:
    """A table per schedule with at least MIN_CHANGES changes on driving logs."""
    runs = _with_changes(collection.runs[collection.runs["scene"].map(is_urban)])
    return [
        _table(schedule, group)
        for schedule, group in runs.groupby("schedule", sort=True)
        if (group["change"] == UNCHANGED).any() and group["change"].nunique() > MIN_CHANGES
    ]


def _with_changes(runs: pd.DataFrame) -> pd.DataFrame:
    """The runs with columns `schedule`, `log` (the scene with its changed settings) and `change`."""
    rows = []
    for run in runs.to_dict("records"):
        schedule, parts = parts_of(run["train"])
        parts = [part for part in parts if not part.startswith(f"{VALIDATION}=")]  # a note says so
        if run["model.motion"] == "static":
            parts = [part for part in parts if part.startswith(OF_STATIC)]
        of_scene = [part for part in parts if part.startswith("scene.") and "background_model" not in part]
        changes = [part for part in parts if part not in of_scene]
        changes += [] if run["ablation"] == MODEL else [run["ablation"]]
        rows.append((schedule, with_parts(run["scene"], of_scene), ", ".join(changes) or UNCHANGED))
    return runs.assign(**{key: [row[i] for row in rows] for i, key in enumerate(("schedule", "log", "change"))})


def _table(schedule: str, runs: pd.DataFrame) -> Table:
    columns = (
        Column("log", "Driving log", False),
        Column("change", "Change", False),
        Column("seeds", "Seeds"),
        *(Column(key, header, ours_only=True) for key, (_, header, _) in METRICS.items()),
    )
    rows = []
    for log in scenes.in_order(runs["log"]):
        of_log = runs[runs["log"] == log]
        unchanged = of_log[of_log["change"] == UNCHANGED]
        if unchanged.empty:
            continue
        rows.append(_row(log, UNCHANGED, unchanged, None))
        for change, changed in of_log[of_log["change"] != UNCHANGED].groupby("change", sort=True):
            common = set(changed["seed"]) & set(unchanged["seed"])
            if common:
                rows.append(_row(log, change, changed[changed["seed"].isin(common)], unchanged))
    notes = (NOTE, *held_out_notes(runs))
    title = f"What each part of an urban model is worth, {schedule}"
    return Table(file_name(f"urban_parts_{schedule}"), title, columns, tuple(rows), notes=notes, over_seeds=False)


def _row(log: str, change: str, runs: pd.DataFrame, unchanged: pd.DataFrame | None) -> Row:
    head = {"log": text(log), "change": text(change), "seeds": number(len(runs), 0)}
    base = None if unchanged is None else unchanged[unchanged["seed"].isin(runs["seed"])]
    return Row(head | {key: _cell(key, runs, base) for key in METRICS})


def _cell(key: str, runs: pd.DataFrame, unchanged: pd.DataFrame | None) -> Cell:
    """The mean of `runs`, or its difference from that of `unchanged`, with its standard error."""
    metric, _, decimals = METRICS[key]
    factor = 100 if key in PERCENT else 1
    found = estimate(factor * runs[metric])
    base = None if unchanged is None else estimate(factor * unchanged[metric])
    if found is None or (unchanged is not None and base is None):
        return NOT_MEASURED
    if base is None:
        return _shown(found.mean, found.standard_error, f",.{decimals}f")
    difference = compare(found, base)
    return _shown(difference.difference, difference.standard_error, f"+,.{decimals}f")


def _shown(value: float, standard_error: float, form: str) -> Cell:
    if math.isnan(standard_error):
        return Cell(format(value, form), value)
    decimals = form.lstrip("+")
    return Cell(f"{value:{form}} ± {STANDARD_ERRORS * standard_error:{decimals}}", value, standard_error)
