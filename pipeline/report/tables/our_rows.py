"""Our rows of the paper's tables, and the notes that our numbers need."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import pandas as pd

from pipeline.presentation.seeds import over_scenes, over_seeds, trains
from pipeline.presentation.table import NO_RUN, Cell, Row, measured, text
from pipeline.runs.read.collect import PROTOCOLS
from pipeline.runs.read.model_labels import LEFT_OUT_NOTE, is_left_out

PROTOCOL_NAME = {"final": "final", "best_on_test": "best on test"}
PROTOCOL_NOTE = (
    "",
    "final: the last iteration. best on test: the best of all test evaluations (the release's "
    "protocol, which picks on the test set).",
)
FLICKER_HEADER = "Flicker ↓ final, levels of 255"
FLICKER_NOTE = ("", "Flicker: mean absolute change of render − truth from one frame of a held-out camera to the next.")


def our_rows(our_trains: list[str], cells_of: Callable[[str, str], dict[str, Cell]]) -> list[Row]:
    """A `final` and a `best on test` row for each schedule."""
    return [
        Row({"method": text(f"Ours, {train}, {PROTOCOL_NAME[p]}"), **cells_of(train, p)})
        for train in our_trains
        for p in PROTOCOLS
    ]


def our_mean_rows(runs: pd.DataFrame, of: tuple[str, ...], metric_of: dict[str, tuple[str, int]]) -> list[Row]:
    """Means over the scenes `of`, column key -> (metric, decimals)."""

    def cells(train: str, protocol: str) -> dict[str, Cell]:
        means = {
            key: over_scenes(runs, of, "full", train, f"{protocol}.{metric}") for key, (metric, _) in metric_of.items()
        }
        count = max(n for _, n in means.values())
        said = str(len(of)) if count == len(of) else f"mean of {count} of {len(of)}"
        return {"scenes": text(said), **{key: measured(means[key][0], metric_of[key][1]) for key in metric_of}}

    return our_rows(trains(runs, of, "full"), cells)


def scene_cell(runs: pd.DataFrame, scene: str, ablation: str, train: str, metric: str, decimals: int = 2) -> Cell:
    """Empty without a run, n/a where the run lacks the metric."""
    mine = runs[(runs["scene"] == scene) & (runs["ablation"] == ablation) & (runs["train"] == train)]
    return NO_RUN if mine.empty else measured(over_seeds(runs, scene, ablation, train, metric), decimals)


def left_out_notes(labels: Iterable[str]) -> list[tuple[str, str]]:
    """What "4DSH left out" means, if a model is called so."""
    return [LEFT_OUT_NOTE] if any(is_left_out(label) for label in labels) else []


def gap_notes(runs: pd.DataFrame, metrics: tuple[str, ...] = ("LPIPS", "MS-SSIM")) -> list[tuple[str, str]]:
    """Why LPIPS or MS-SSIM is missing, as the runs say. metrics: which of both a table has."""
    columns = {"LPIPS": "lpips_note", "MS-SSIM": "ms_ssim_note"}
    return [
        ("", note if note.startswith(name) else f"{name}: {note}")
        for name in metrics
        for note in sorted(set(runs[columns[name]]))
        if note
    ]
