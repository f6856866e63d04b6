"""What each change of a schedule is worth: its variants against the schedule as it is, scene by scene.

A variant is what variants.py calls `fast (dropout=0.1)`: the schedule's name, and in brackets what was changed. What is
in brackets of the scene and its start is no change of the schedule: `fast (scene.downscale=4, dropout=0.1)` is compared
with `fast (scene.downscale=4)`. Only scenes and seeds that both have are compared.
"""

from __future__ import annotations

import math
import re

import numpy as np
import pandas as pd

from pipeline.presentation.seeds import compare, estimate
from pipeline.presentation.table import NO_RUN, Cell, Column, Row, Table, text
from pipeline.report.read import scenes
from pipeline.runs.read.collect import Collection
from pipeline.runs.read.model_labels import asked, is_left_out
from pipeline.runs.read.names import file_name, parts_of, with_parts

STUDY = "study_"  # how the slugs of its tables begin
MIN_VARIANTS = 2  # one alone is what other tables compare
_OF_THE_SCENE = ("scene.", "init.", "background=")
_RATIOS = {"train_seconds": "Train s ×", "n_gaussians": "N ×", "model_mb": "MB ×", "final.fps_render": "FPS ×"}
NOTE = (
    "",
    "Change − schedule as it is: final PSNR in dB (and SSIM), ± the standard error of the difference over the seeds; "
    "the mean is over the scenes that both have, its standard error from theirs. ×: ratio of the means, geometric mean "
    "over scenes.",
)


def studies(collection: Collection) -> list[Table]:
    """A table for each schedule and ablation of which at least MIN_VARIANTS variants were run."""
    runs, tables = _told_apart(collection.runs), []
    # What selection leaves out is a schedule's doing: changes are compared by what they were asked for.
    for (schedule, ablation), group in runs.groupby(["schedule", runs["ablation"].map(asked)], sort=True):
        usual, changed = group[group["change"] == ""], group[group["change"] != ""]
        names = [scene for scene in scenes.in_order(changed["scene"]) if (usual["scene"] == scene).any()]
        rows = [
            row
            for change, runs_of in changed.groupby("change", sort=True)
            if (row := _row(change, runs_of, usual, names)) is not None
        ]
        if len(rows) >= MIN_VARIANTS:
            tables.append(_table(schedule, ablation, names, rows, _selected_notes(group)))
    return tables


def _told_apart(runs: pd.DataFrame) -> pd.DataFrame:
    """The runs with their `schedule` and `change`, and what was changed of a scene in the scene's name."""
    rows = []
    for scene, name in zip(runs["scene"], runs["train"]):
        schedule, parts = parts_of(name)
        of_scene = [part for part in parts if part.startswith(_OF_THE_SCENE)]
        rows.append((with_parts(scene, of_scene), schedule, ", ".join(p for p in parts if p not in of_scene)))
    return runs.assign(**{key: [row[i] for row in rows] for i, key in enumerate(("scene", "schedule", "change"))})


def _selected_notes(runs: pd.DataFrame) -> list[tuple[str, str]]:
    """Of which changes on which scenes selection left 4DSH out of the models."""
    found = runs[runs["ablation"].map(is_left_out).astype(bool)].groupby("change", sort=True)["scene"]
    said = [f"{change or 'the schedule as it is'} ({', '.join(scenes.in_order(names))})" for change, names in found]
    note = f"Selection by validation left 4DSH, time-varying colour, out of models of: {'; '.join(said)}."
    return [("", note)] if said else []


def _table(schedule: str, ablation: str, names: list[str], rows: list[Row], notes: list[tuple[str, str]]) -> Table:
    columns = (
        Column("change", "Change", False),
        *(Column(scene, scene, group="scenes") for scene in names),
        Column("mean", "mean, dB", group="means"),
        Column("ssim", "mean, SSIM", group="means"),
        *(Column(key, header, group="means") for key, header in _RATIOS.items()),
    )
    of = schedule if ablation == "full" else f"{schedule}, {ablation}"
    best_first = sorted(rows, key=lambda row: -row.cells["mean"].value)
    slug = file_name(STUDY + re.sub(r"[^\w.-]+", "_", of))
    return Table(slug, f"What changes of {of} are worth", columns, tuple(best_first), notes=(NOTE, *notes))


def _row(change: str, runs: pd.DataFrame, usual: pd.DataFrame, names: list[str]) -> Row | None:
    """One change on every scene; None where no scene has both."""
    cells, ratios = {"change": text(change)}, {key: [] for key in _RATIOS}
    differences, structure = [], []
    for scene in names:
        ours, theirs = _of_common_seeds(runs[runs["scene"] == scene], usual[usual["scene"] == scene])
        after, before = estimate(ours["final.psnr"]), estimate(theirs["final.psnr"])
        if after is None or before is None:
            cells[scene] = NO_RUN
            continue
        found = compare(after, before)
        differences.append((found.difference, found.standard_error))
        cells[scene] = _signed(found.difference, found.standard_error)
        similar = compare(estimate(ours["final.ssim"]), estimate(theirs["final.ssim"]))
        structure.append((similar.difference, similar.standard_error))
        for key in _RATIOS:
            ratios[key].append(ours[key].mean() / theirs[key].mean())
    if not differences:
        return None
    cells["mean"], cells["ssim"] = _signed(*_mean(differences)), _signed(*_mean(structure), digits=4)
    for key, values in ratios.items():
        ratio = float(np.exp(np.mean(np.log(values))))
        cells[key] = Cell(f"{ratio:.2f}", ratio)
    return Row(cells)


def _of_common_seeds(ours: pd.DataFrame, theirs: pd.DataFrame) -> tuple[pd.DataFrame, pd.DataFrame]:
    common = set(ours["seed"]) & set(theirs["seed"])
    return ours[ours["seed"].isin(common)], theirs[theirs["seed"].isin(common)]


def _mean(found: list[tuple[float, float]]) -> tuple[float, float]:
    """Of differences with their standard errors, over the scenes."""
    return float(np.mean([d for d, _ in found])), math.sqrt(sum(e**2 for _, e in found)) / len(found)


def _signed(difference: float, standard_error: float, digits: int = 2) -> Cell:
    if math.isnan(standard_error):  # one seed
        return Cell(f"{difference:+.{digits}f}", difference)
    return Cell(f"{difference:+.{digits}f} ± {standard_error:.{digits}f}", difference, standard_error)
