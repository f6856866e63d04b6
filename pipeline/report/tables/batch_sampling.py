"""PSNR and flicker by sampler and batch size, all other settings equal.

The paper claims that batches over several times reduce flicker. The flicker of each sampler and batch size is compared
with that of the paper's batches: `pairs`, with the largest batch size of the comparison.
"""

from __future__ import annotations

import json
import re
from typing import Any

import pandas as pd

from pipeline.presentation.seed_statistics import Estimate, compare, estimate
from pipeline.presentation.table import NOTHING, Cell, Column, Row, Table, measured, number, text, uncertainty
from pipeline.report.read import scenes
from pipeline.report.tables.footnotes import FLICKER_HEADER, FLICKER_NOTE, left_out_notes
from pipeline.runs.read.collect import Collection
from pipeline.runs.read.run_names import parts_of, with_parts
from pipeline.runs.read.variants import schedule_settings

KEYS = {"train.sampler": str, "train.batch": int}  # key -> type of a valid value
_IN_NAME = re.compile(r"\b(sampler|batch)=\w+")  # in a schedule's name, as written by variants.py
SAMPLER_NOTE = (
    "",
    "pairs: any camera at any time. views_at_one_time: several cameras at one time. times_of_one_view: one camera at "
    "several times. At equal iterations a batch of 4 uses four times as many images as a batch of 1.",
)
VERDICT_NOTE = (
    "",
    "The paper's batches: pairs with the largest batch size. The verdict is on final flicker (lower is better), by the "
    "rule of the table of ablations.",
)


def batch_sampling(collection: Collection) -> Table | None:
    """A row per sampler × batch size, for scenes, models and schedules with at least two of them; None without rows."""
    settings = collection.settings
    runs = collection.runs
    runs = runs[[all(isinstance(settings[run].get(key), kind) for key, kind in KEYS.items()) for run in runs["run"]]]
    runs = runs.assign(
        schedule=[without_batch(name) for name in runs["train"]],
        sampler=[settings[run]["train.sampler"] for run in runs["run"]],
        batch=[settings[run]["train.batch"] for run in runs["run"]],
        rest=[_rest(settings[run]) for run in runs["run"]],
    )
    rows = []
    for scene in scenes.in_order(runs["scene"]):
        of_scene = runs[runs["scene"] == scene]
        for ablation in scenes.ablations_in_order(of_scene["ablation"]):
            of_ablation = of_scene[of_scene["ablation"] == ablation]
            for (schedule, _), group in of_ablation.groupby(["schedule", "rest"]):
                by_batch = group.groupby(["sampler", "batch"])
                if len(by_batch) < 2:
                    continue
                head = {"scene": text(scene), "ablation": text(ablation), "train": text(schedule)}
                of_paper = max((key for key in by_batch.groups if key[0] == "pairs"), default=None)
                rows += [
                    Row(
                        head
                        | {"sampler": text(key[0]), "batch": number(key[1], 0)}
                        | _cells(same)
                        | _verdict_cells(same, None if key == of_paper else group, of_paper)
                    )
                    for key, same in by_batch
                ]
    if not rows:
        return None
    columns = (
        Column("scene", "Scene", False),
        Column("ablation", "Model", False, fold=True),
        Column("train", "Schedule", False, fold=True),
        Column("sampler", "Sampler", False),
        Column("batch", "Batch"),
        Column("seeds", "Seeds", fold=True),
        Column("iterations", "Iterations", fold=True, group="quality"),
        Column("train_seconds", "Train s", group="quality"),
        Column("final_psnr", "PSNR ↑ final", group="quality"),
        Column("best_psnr", "PSNR ↑ best on test", group="quality"),
        Column("final_flicker", FLICKER_HEADER, group="flicker"),
        Column("more_flicker", "this − paper's batches, flicker", group="flicker"),
        Column("two_se", "2 SE", group="flicker"),
        Column("verdict", "vs paper's batches", False, group="flicker"),
    )
    notes = (SAMPLER_NOTE, FLICKER_NOTE, VERDICT_NOTE, *left_out_notes(row.cells["ablation"].text for row in rows))
    return Table("batches", "Batch sampling and flicker", columns, tuple(rows), notes=notes)


def without_batch(train: str) -> str:
    """The schedule's name without sampler and batch size: `fast (batch=1, dropout=0.1)` -> `fast (dropout=0.1)`."""
    name, parts = parts_of(train)
    return with_parts(name, [part for part in parts if not _IN_NAME.fullmatch(part)])


def _rest(settings: dict[str, Any]) -> str:
    """All other settings, as JSON."""
    kept = {key: value for key, value in schedule_settings(settings).items() if key not in KEYS}
    return json.dumps(kept, sort_keys=True, default=str)


def _verdict_cells(runs: pd.DataFrame, group: pd.DataFrame | None, of_paper: tuple[str, int] | None) -> dict[str, Cell]:
    """The flicker of `runs` compared with the paper's batches in `group`; group None: `runs` are those."""
    nothing = dict.fromkeys(("more_flicker", "two_se", "verdict"), NOTHING)
    if group is None or of_paper is None:
        return nothing
    is_paper = (group["sampler"] == of_paper[0]) & (group["batch"] == of_paper[1])
    paper, other = _negative_flicker(group[is_paper]), _negative_flicker(runs)
    if paper is None or other is None:
        return nothing
    found = compare(paper, other)
    return {
        "more_flicker": number(found.difference),
        "two_se": uncertainty(2 * found.standard_error),
        "verdict": text(found.word),
    }


def _negative_flicker(runs: pd.DataFrame) -> Estimate | None:
    """Negated, since `compare` takes higher as better."""
    return estimate(-runs.drop_duplicates("seed")["final.flicker_levels"])


def _cells(runs: pd.DataFrame) -> dict[str, Cell]:
    """Means over seeds. A seed counts once, also where two runs spell a setting differently."""
    runs = runs.drop_duplicates("seed")
    of = {
        "iterations": ("iterations", 0),
        "train_seconds": ("train_seconds", 0),
        "final_psnr": ("final.psnr", 2),
        "best_psnr": ("best_on_test.psnr", 2),
        "final_flicker": ("final.flicker_levels", 2),
    }
    return {"seeds": number(len(runs), 0)} | {
        key: measured(estimate(runs[metric]), decimals) for key, (metric, decimals) in of.items()
    }
