"""The ablations on the synthetic scenes made for them, with a verdict on each: worse, better or no difference shown."""

from __future__ import annotations

import pandas as pd

from pipeline.presentation.seed_statistics import FORMULA, MIN_SEEDS, Verdict, select, trains, verdict
from pipeline.presentation.table import Cell, Column, Row, Table, measured, number, text, uncertainty
from pipeline.report.read import scenes
from pipeline.report.tables.footnotes import PROTOCOL_NOTE
from pipeline.runs.read.model_labels import LEFT_OUT_NOTE, ablation_of, baseline_of, is_left_out
from pipeline.runs.read.run_files import PROTOCOLS

_COLUMNS = (
    Column("ablation", "Ablation", False),
    Column("scene", "Scene", False),
    Column("train", "Schedule", False, fold=True),
    Column("protocol", "Protocol", False),
    Column("full_psnr", "PSNR of full"),
    Column("ablation_psnr", "PSNR of ablation"),
    Column("difference", "full − ablation"),
    Column("two_se", "2 SE"),
    Column("verdict", "Verdict", False),
)


def made_for_labels(runs: pd.DataFrame, made: scenes.MadeFor, train: str) -> list[str]:
    """The labels of this ablation among the runs: `no_4drot`, `no_4drot, 4DSH left out`."""
    here = runs[(runs["scene"] == made.scene) & (runs["train"] == train)]["ablation"]
    return [label for label in scenes.ablations_in_order(here) if ablation_of(label) == made.ablation]


def ablation_verdicts(runs: pd.DataFrame) -> Table | None:
    """A row per ablation with runs on the scene made for it, schedule and protocol; None without runs."""
    rows, shown = [], []
    for made in scenes.MADE_FOR:
        for train in trains(runs, [made.scene]):
            for label in made_for_labels(runs, made, train):
                shown.append((made, label))
                head = {"ablation": text(label), "scene": text(made.scene), "train": text(train)}
                rows += [
                    Row(
                        head
                        | {"protocol": text(protocol.replace("_", " "))}
                        | _cells(runs, made.scene, label, train, f"{protocol}.psnr")
                    )
                    for protocol in PROTOCOLS
                ]
    if not rows:
        return None
    reasons = tuple(
        ("", f"{made.scene} is made for {made.ablation}: {made.reason}.")
        for made in scenes.MADE_FOR
        if any(made == one for one, _ in shown)
    )
    selected = (
        (LEFT_OUT_NOTE, ("", "Such a model is compared with full, 4DSH left out."))
        if any(is_left_out(label) for _, label in shown)
        else ()
    )
    return Table(
        "ablation_verdicts",
        "Ablations on the scenes made for them",
        _COLUMNS,
        tuple(rows),
        caption=FORMULA,
        notes=(*reasons, *selected, PROTOCOL_NOTE),
    )


def _cells(runs: pd.DataFrame, scene: str, label: str, train: str, metric: str) -> dict[str, Cell]:
    found = verdict(runs, scene, label, train, metric)
    if found is None:
        baseline = baseline_of(label)
        no_run = baseline is None or select(runs, scene, baseline, train).empty
        return {"verdict": text(f"no run of {baseline}" if no_run else "not measured")}
    return {
        "full_psnr": measured(found.full),
        "ablation_psnr": measured(found.ablation),
        "difference": number(found.difference),
        "two_se": uncertainty(2 * found.standard_error),
        "verdict": text(_verdict_text(found)),
    }


def _verdict_text(found: Verdict) -> str:
    """The verdict's word, with the number of seeds where that is too small."""
    seeds = min(found.full.n, found.ablation.n)
    return found.word if seeds >= MIN_SEEDS else f"{found.word} ({seeds} of {MIN_SEEDS})"
