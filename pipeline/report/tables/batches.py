"""Runs that differ in what a batch is made of: is a batch over time worth it, and does it flicker less?

The paper claims that batches over time make films flicker less. So PSNR and flicker stand side by side for each
sampler and batch size that was tried on a scene, everything else being equal, and the flicker of each is compared
with that of the paper's batches: `pairs`, the largest batch of the comparison.
"""

from __future__ import annotations

import json
import re
from typing import Any

import pandas as pd

from pipeline.presentation.seeds import Estimate, compare, estimate
from pipeline.presentation.table import NOTHING, Cell, Column, Row, Table, measured, number, text, uncertainty
from pipeline.report.read import scenes
from pipeline.report.tables.our_rows import FLICKER_HEADER, FLICKER_NOTE, left_out_notes
from pipeline.runs.read.collect import Collection
from pipeline.runs.read.variants import schedule_settings

KEYS = {"train.sampler": str, "train.batch": int}  # and what a setting must be to be compared
_IN_NAME = re.compile(r"\b(sampler|batch)=\w+")  # as variants.py writes them into a schedule's name
SAMPLER_NOTE = (
    "",
    "pairs: any camera at any moment. views_at_one_time: cameras at one moment. times_of_one_view: moments of one "
    "camera. At equal iterations a batch of 4 sees four times the images of a batch of 1.",
)
VERDICT_NOTE = (
    "",
    "The paper's batches: pairs, the largest batch of the comparison. Verdict: final flicker, by the rule of the "
    "ablation verdicts; worse is more.",
)


def batches(collection: Collection) -> Table | None:
    """A row for each sampler × batch size where a scene, ablation and schedule has two at least; else None."""
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
                made_of = group.groupby(["sampler", "batch"])
                if len(made_of) < 2:
                    continue
                head = {"scene": text(scene), "ablation": text(ablation), "train": text(schedule)}
                of_paper = max((key for key in made_of.groups if key[0] == "pairs"), default=None)
                rows += [
                    Row(
                        head
                        | {"sampler": text(key[0]), "batch": number(key[1], 0)}
                        | _cells(same)
                        | _verdict_cells(same, None if key == of_paper else group, of_paper)
                    )
                    for key, same in made_of
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
    return Table("batches", "Batches and flicker", columns, tuple(rows), notes=notes)


def without_batch(train: str) -> str:
    """`fast (batch=1, iterations=600)` -> `fast (iterations=600)`: the schedule but for what a batch is made of."""
    name, bracket, inside = train.partition(" (")
    kept = [part for part in inside.removesuffix(")").split(", ") if part and not _IN_NAME.fullmatch(part)]
    return f"{name}{bracket}{', '.join(kept)})" if kept else name


def _rest(settings: dict[str, Any]) -> str:
    """All other settings, as one text to compare."""
    kept = {key: value for key, value in schedule_settings(settings).items() if key not in KEYS}
    return json.dumps(kept, sort_keys=True, default=str)


def _verdict_cells(runs: pd.DataFrame, group: pd.DataFrame | None, of_paper: tuple[str, int] | None) -> dict[str, Cell]:
    """`runs` against those of the group that were made as the paper's; group None: they are those."""
    nothing = dict.fromkeys(("more_flicker", "two_se", "verdict"), NOTHING)
    if group is None or of_paper is None:
        return nothing
    same = (group["sampler"] == of_paper[0]) & (group["batch"] == of_paper[1])
    theirs, ours = _less_is_more(group[same]), _less_is_more(runs)
    if theirs is None or ours is None:
        return nothing
    found = compare(theirs, ours)
    return {
        "more_flicker": number(found.difference),
        "two_se": uncertainty(2 * found.standard_error),
        "verdict": text(found.word),
    }


def _less_is_more(runs: pd.DataFrame) -> Estimate | None:
    """Of minus the flicker: `compare` takes more for better."""
    return estimate(-runs.drop_duplicates("seed")["final.flicker_levels"])


def _cells(runs: pd.DataFrame) -> dict[str, Cell]:
    """Of runs that differ in their seed; a seed that was run under two spellings of one setting counts once."""
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
