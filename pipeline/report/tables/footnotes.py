"""Footnotes that several tables share: evaluation protocol, flicker, selection of 4DSH, missing metrics."""

from __future__ import annotations

from collections.abc import Iterable

import pandas as pd

from pipeline.runs.read.model_labels import LEFT_OUT_NOTE, is_left_out

PROTOCOL_NOTE = (
    "",
    "final: the last iteration. best on test: the best of all test evaluations. The authors' release reports the "
    "latter, which selects on the test set.",
)
FLICKER_HEADER = "Flicker ↓ final, levels of 255"
FLICKER_NOTE = ("", "Flicker: mean absolute change of render − truth between consecutive frames of a held-out camera.")


def left_out_notes(labels: Iterable[str]) -> list[tuple[str, str]]:
    """The meaning of "4DSH left out", if a model label has it."""
    return [LEFT_OUT_NOTE] if any(is_left_out(label) for label in labels) else []


def missing_metric_notes(runs: pd.DataFrame, metrics: tuple[str, ...] = ("LPIPS", "MS-SSIM")) -> list[tuple[str, str]]:
    """Why LPIPS or MS-SSIM is missing, as the runs record it. metrics: those of the table."""
    columns = {"LPIPS": "lpips_note", "MS-SSIM": "ms_ssim_note"}
    return [
        ("", note if note.startswith(name) else f"{name}: {note}")
        for name in metrics
        for note in sorted(set(runs[columns[name]]))
        if note
    ]


def held_out_notes(runs: pd.DataFrame) -> list[tuple[str, str]]:
    """The rule of the held-out views of each scene, as the runs record it."""
    rules = runs[["scene", "test_split"]].drop_duplicates().to_dict("records")
    return [("", f"{rule['scene']}: held out {rule['test_split']}.") for rule in rules if rule["test_split"]]
