"""Effect of changed settings: each variant of a schedule minus the unchanged schedule, per scene.

A variant is a name such as `fast (dropout=0.1)` (variants.py). Changes of the scene and its initialisation are not
changes of the schedule: `fast (scene.downscale=4, dropout=0.1)` is compared with `fast (scene.downscale=4)`. Only
common scenes and seeds are compared.
"""

from __future__ import annotations

import math

import numpy as np
import pandas as pd

from pipeline.presentation.seed_statistics import compare, estimate
from pipeline.presentation.table import NO_RUN, Cell, Column, Row, Table, number, text
from pipeline.report.read import scenes
from pipeline.report.tables.footnotes import held_out_notes
from pipeline.runs.read.collect import Collection
from pipeline.runs.read.model_labels import is_left_out, requested
from pipeline.runs.read.run_names import file_name, parts_of, with_parts

STUDY = "study_"  # prefix of the tables' slugs
MIN_VARIANTS = 2  # a single variant is compared in other tables
_SCENE_KEYS = ("scene.", "init.")
_MOVING, _FOREGROUND = "final.psnr_moving", "final.psnr_foreground"  # columns that runs without such pixels lack
_RATIOS = {"train_seconds": "Train s ×", "n_gaussians": "N ×", "model_mb": "MB ×", "final.fps_render": "FPS ×"}
NOTE = (
    "",
    "Changed − unchanged schedule: final PSNR in dB (and SSIM), ± standard error of the difference over seeds. The "
    "mean is over common scenes, with the standard error propagated from theirs; no ±: one seed. Moving, foreground: "
    "PSNR of these pixels; the mean is over the scenes that have them. In the CSV, _std is the standard error. "
    "×: ratio of the means over seeds, geometric mean over scenes.",
)


def changed_settings(collection: Collection) -> list[Table]:
    """A table per schedule and model with at least MIN_VARIANTS variants."""
    runs, tables = _with_changes(collection.runs), []
    # Variants are compared for one requested model: selection by validation is a part of the schedule.
    for (schedule, ablation), group in runs.groupby(["schedule", runs["ablation"].map(requested)], sort=True):
        unchanged, changed = group[group["change"] == ""], group[group["change"] != ""]
        names = [scene for scene in scenes.in_order(changed["scene"]) if (unchanged["scene"] == scene).any()]
        rows = [
            row
            for change, variant in changed.groupby("change", sort=True)
            if (row := _row(change, variant, unchanged, names)) is not None
        ]
        if len(rows) >= MIN_VARIANTS:
            notes = [*_selected_notes(group), *held_out_notes(collection.runs.loc[group.index])]
            tables.append(_table(schedule, ablation, names, rows, notes))
    return tables


def scene_settings(train: str) -> list[str]:
    """Of a schedule's name, the settings in brackets that change images, views or initial points of the scene."""
    return [part for part in parts_of(train)[1] if part.startswith(_SCENE_KEYS)]


def _with_changes(runs: pd.DataFrame) -> pd.DataFrame:
    """The runs with columns `schedule` and `change`; changed scene settings become a part of the scene's name."""
    rows = []
    for scene, name in zip(runs["scene"], runs["train"]):
        schedule, parts = parts_of(name)
        scene_parts = scene_settings(name)
        rows.append((with_parts(scene, scene_parts), schedule, ", ".join(p for p in parts if p not in scene_parts)))
    return runs.assign(**{key: [row[i] for row in rows] for i, key in enumerate(("scene", "schedule", "change"))})


def _selected_notes(runs: pd.DataFrame) -> list[tuple[str, str]]:
    """The changes and scenes for which selection left 4DSH out."""
    found = runs[runs["ablation"].map(is_left_out).astype(bool)].groupby("change", sort=True)["scene"]
    listed = [f"{change or 'the unchanged schedule'} ({', '.join(scenes.in_order(names))})" for change, names in found]
    note = f"Selection by validation removed 4DSH (time-varying colour) from models of: {'; '.join(listed)}."
    return [("", note)] if listed else []


def _table(schedule: str, ablation: str, names: list[str], rows: list[Row], notes: list[tuple[str, str]]) -> Table:
    optional = (
        *(Column(_moving_of(scene), f"{scene} moving", group="moving") for scene in names),
        Column("moving", "mean, moving", group="means"),
        Column("foreground", "mean, foreground", group="means"),
    )
    columns = (
        Column("change", "Change", False),
        *(Column(scene, scene, group="scenes") for scene in names),
        Column("mean", "mean, dB", group="means"),
        *(column for column in optional if any(column.key in row.cells for row in rows)),
        Column("ssim", "mean, SSIM", group="means"),
        *(Column(key, header, group="means") for key, header in _RATIOS.items()),
    )
    of = schedule if ablation == "full" else f"{schedule}, {ablation}"
    best_first = sorted(rows, key=lambda row: -(row.cells["mean"].value or 0.0))
    slug = file_name(STUDY + of)
    return Table(
        slug, f"Effect of changed settings of {of}", columns, tuple(best_first), notes=(NOTE, *notes), over_seeds=False
    )


def _moving_of(scene: str) -> str:
    """The key of the column of a scene's moving pixels."""
    return f"{scene}_moving"


def _row(change: str, variant: pd.DataFrame, unchanged: pd.DataFrame, names: list[str]) -> Row | None:
    """One change on every scene; None without a common scene and seed."""
    cells = {"change": text(change)}
    ratios: dict[str, list[float]] = {key: [] for key in _RATIOS}
    psnr, ssim, moving, foreground = [], [], [], []
    for scene in names:
        changed, base = _of_common_seeds(variant[variant["scene"] == scene], unchanged[unchanged["scene"] == scene])
        in_psnr, in_ssim = (_difference(changed[metric], base[metric]) for metric in ("final.psnr", "final.ssim"))
        if in_psnr is None or in_ssim is None:
            cells[scene] = NO_RUN
            continue
        psnr.append(in_psnr)
        ssim.append(in_ssim)
        cells[scene] = _signed(*in_psnr)
        if (in_moving := _difference(changed[_MOVING], base[_MOVING])) is not None:
            moving.append(in_moving)
            cells[_moving_of(scene)] = _signed(*in_moving)
        if (in_foreground := _difference(changed[_FOREGROUND], base[_FOREGROUND])) is not None:
            foreground.append(in_foreground)
        for key in _RATIOS:
            ratios[key].append(_ratio(changed[key], base[key]))
    if not psnr:
        return None
    cells["mean"], cells["ssim"] = _signed(*_mean(psnr)), _signed(*_mean(ssim), digits=4)
    cells |= {key: _signed(*_mean(of)) for key, of in (("moving", moving), ("foreground", foreground)) if of}
    for key, values in ratios.items():
        cells[key] = number(float(np.exp(np.mean(np.log(values)))))
    return Row(cells)


def _difference(changed: pd.Series, base: pd.Series) -> tuple[float, float] | None:
    """Difference of the means and its standard error; None without runs."""
    after, before = estimate(changed), estimate(base)
    if after is None or before is None:
        return None
    found = compare(after, before)
    return found.difference, found.standard_error


def _ratio(changed: pd.Series, base: pd.Series) -> float:
    """Ratio of the means; NaN where a run lacks the number."""
    after, before = estimate(changed), estimate(base)
    return math.nan if after is None or before is None else after.mean / before.mean


def _of_common_seeds(one: pd.DataFrame, other: pd.DataFrame) -> tuple[pd.DataFrame, pd.DataFrame]:
    common = set(one["seed"]) & set(other["seed"])
    return one[one["seed"].isin(common)], other[other["seed"].isin(common)]


def _mean(found: list[tuple[float, float]]) -> tuple[float, float]:
    """Mean over scenes of (difference, standard error), with the propagated standard error."""
    return float(np.mean([d for d, _ in found])), math.sqrt(sum(e**2 for _, e in found)) / len(found)


def _signed(difference: float, standard_error: float, digits: int = 2) -> Cell:
    if math.isnan(standard_error):  # one seed
        return Cell(f"{difference:+.{digits}f}", difference)
    return Cell(f"{difference:+.{digits}f} ± {standard_error:.{digits}f}", difference, standard_error)
