"""Leaderboards: the methods of one protocol, ranked by their mean final PSNR over its scenes.

Only methods with a run of every scene that the protocol's runs have are ranked; others follow, as means over fewer
scenes are no measure of a method. Images that were given rank beside runs and are marked.
"""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd

from pipeline.evaluation.protocol import in_words
from pipeline.presentation.table import NO_RUN, NOTHING, Cell, Column, Row, Table
from pipeline.report.run_table import HEADERS, Shown, gpu_notes
from pipeline.report.runs import RENDERED

_METHOD = ("recipe_label", "model", "images")
_NUMBERS = ("psnr", "ssim", "lpips_vgg", "train_seconds", "n_gaussians")


def leaderboards(runs: pd.DataFrame) -> list[Table]:
    """One for each protocol of `runs` (Collection.runs), those with a name first."""
    ids = sorted(runs["protocol"].unique(), key=lambda name: (name.startswith("un"), name))
    return [_leaderboard(protocol, runs[runs["protocol"] == protocol]) for protocol in ids]


def _leaderboard(protocol: str, runs: pd.DataFrame) -> Table:
    count = runs["scene_label"].nunique()
    shown = [one for one in map(Shown, _NUMBERS) if one.key == "psnr" or one.numbers(runs).notna().any()]
    methods = [(names, found) for names, found in runs.groupby(list(_METHOD), sort=True)]
    complete = [found["scene_label"].nunique() == count for _, found in methods]
    psnr = [Shown("psnr").cell(found) for _, found in methods]
    places = sorted(range(len(methods)), key=lambda i: (not complete[i], -(psnr[i].value or 0.0)))
    rows = [_row(methods[i][0], methods[i][1], shown, count) for i in places]
    ranks = [Cell(str(place)) if complete[i] else NOTHING for place, i in enumerate(places, 1)]
    columns = (
        Column("rank", "Rank"),
        Column("method", "Method", False),
        Column("images", HEADERS["images"], False),
        *(Column(one.column, one.header) for one in shown),
        Column("scenes", "Scenes", fold=True),
        Column("seeds", "Runs", fold=True),
    )
    ranked = tuple(Row({"rank": rank} | cells) for rank, cells in zip(ranks, rows))
    notes = tuple(("", note) for note in (in_words(protocol), *gpu_notes(runs, _NUMBERS)))
    return Table(f"leaderboard_{protocol}", protocol, columns, ranked, notes=notes, section="leaderboards")


def _row(names: Sequence[str], runs: pd.DataFrame, shown: Sequence[Shown], count: int) -> dict[str, Cell]:
    recipe, model, images = names
    covered = runs["scene_label"].nunique()
    cells = {
        "method": Cell(f"{recipe}, {model}" if images == RENDERED else recipe),
        "images": Cell("rendered" if images == RENDERED else "images given"),
        "scenes": Cell(f"{covered} of {count}"),
        "seeds": Cell(str(len(runs))),
    }
    return cells | {one.column: one.cell(runs) if not runs.empty else NO_RUN for one in shown}
