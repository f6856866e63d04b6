"""Is each ablation worse than the whole model on the scene made for it?"""

from __future__ import annotations

import pandas as pd

from pipeline.presentation.seeds import FORMULA, Verdict, select, trains, verdict
from pipeline.presentation.table import Cell, Column, Row, Table, measured, number, text, uncertainty
from pipeline.report.read import scenes
from pipeline.report.tables.our_rows import PROTOCOL_NOTE
from pipeline.runs.read.collect import PROTOCOLS
from pipeline.runs.read.model_labels import LEFT_OUT_NOTE, ablation_of, is_left_out, reference

_COLUMNS = (
    Column("ablation", "Ablation", False),
    Column("scene", "Made for it", False),
    Column("train", "Schedule", False, fold=True),
    Column("protocol", "Model", False),
    Column("full_psnr", "full, PSNR"),
    Column("ablation_psnr", "ablation, PSNR"),
    Column("difference", "full − ablation"),
    Column("two_se", "2 SE"),
    Column("verdict", "Verdict", False),
)


def made_for_labels(runs: pd.DataFrame, made: scenes.MadeFor, train: str) -> list[str]:
    """The models under `train`, on the scene, that are this ablation: `no_4drot`, `no_4drot, 4DSH left out`."""
    here = runs[(runs["scene"] == made.scene) & (runs["train"] == train)]["ablation"]
    return [label for label in scenes.ablations_in_order(here) if ablation_of(label) == made.ablation]


def verdicts(runs: pd.DataFrame) -> Table | None:
    """A row for each ablation that was run on the scene made for it, schedule and protocol; None without one."""
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
        ("", f"{made.scene} for {made.ablation}: {made.reason}.")
        for made in scenes.MADE_FOR
        if any(made == one for one, _ in shown)
    )
    selected = (
        (LEFT_OUT_NOTE, ("", "Such a model is compared with a full model whose time-varying colour was left out too."))
        if any(is_left_out(label) for _, label in shown)
        else ()
    )
    return Table(
        "ablation_verdicts",
        "Does each part earn its place? Ablations on the scenes made for them",
        _COLUMNS,
        tuple(rows),
        caption=FORMULA,
        notes=(*reasons, *selected, PROTOCOL_NOTE),
    )


def _cells(runs: pd.DataFrame, scene: str, label: str, train: str, metric: str) -> dict[str, Cell]:
    found = verdict(runs, scene, label, train, metric)
    if found is None:
        whole = reference(label)
        return {"verdict": text(f"no run of {whole}" if select(runs, scene, whole, train).empty else "not measured")}
    return {
        "full_psnr": measured(found.full),
        "ablation_psnr": measured(found.ablation),
        "difference": number(found.difference),
        "two_se": uncertainty(2 * found.standard_error),
        "verdict": text(_sentence(found)),
    }


def _sentence(found: Verdict) -> str:
    """The verdict's word and, where it is not the hoped-for one, that."""
    if found.word == "too few seeds":
        return f"too few seeds ({min(found.full.n, found.ablation.n)} of 3)"
    return {
        "worse": "worse, as it should be",
        "better": "NOT worse: better",
        "no difference shown": "NOT shown to be worse",
    }[found.word]
