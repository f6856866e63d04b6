"""One table per family of scenes: every scene × schedule × model."""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd

from pipeline.presentation.seed_statistics import over_seeds, select, verdict
from pipeline.presentation.table import NOTHING, Cell, Column, Row, Table, measured, number, text, uncertainty
from pipeline.report.read import scenes
from pipeline.report.read.evaluation_split import other_split_notes
from pipeline.report.tables.footnotes import (
    FLICKER_HEADER,
    FLICKER_NOTE,
    PROTOCOL_NOTE,
    held_out_notes,
    left_out_notes,
    missing_metric_notes,
)
from pipeline.report.tables.motion_columns import NOTE as MOTION_NOTE
from pipeline.report.tables.motion_columns import MotionColumn, motion_columns
from pipeline.runs.read.collect import Collection

_FAMILY_TITLE = {
    "synthetic": "Synthetic scenes",
    "dnerf": "D-NeRF",
    "plenoptic": "Plenoptic Video",
    "dnerf_own": "Own scenes in the D-NeRF layout",
    "plenoptic_own": "Own scenes in the Plenoptic Video layout",
    "video_own": "Own videos",
    "urban": "Driving logs",
    "other": "Other scenes",
}
_ALEX = ("plenoptic", "plenoptic_own", "video_own")  # LPIPS network in the literature for these; VGG for others


def scene_tables(collection: Collection) -> list[Table]:
    """The tables of all families with runs, in the order of the report."""
    present = set(collection.runs["scene"].map(scenes.family))
    return [
        scene_table(collection.runs, family, other_split_notes(collection))
        for family in scenes.FAMILIES
        if family in present
    ]


def scene_table(runs: pd.DataFrame, family: str, split_notes: Sequence[tuple[str, str]] = ()) -> Table:
    """Every scene of a family × schedule × model, with `final` and `best on test`.

    split_notes: (scene, note) for runs on another split, see other_split_notes.
    """
    present = runs[runs["scene"].map(scenes.family) == family]
    with_flicker, net = present["final.flicker"].notna().any(), "alex" if family in _ALEX else "vgg"
    motion = motion_columns(present)
    rows = []
    for scene in scenes.in_order(present["scene"]):
        of_scene = present[present["scene"] == scene]
        for train in sorted(of_scene["train"].unique()):
            for name in scenes.ablations_in_order(of_scene[of_scene["train"] == train]["ablation"]):
                head = {"scene": text(scene), "train": text(train), "ablation": text(name)}
                rows.append(Row(head | _scene_cells(of_scene, scene, name, train, net, motion)))
    notes = [PROTOCOL_NOTE, *missing_metric_notes(present, ("LPIPS",)), *left_out_notes(present["ablation"])]
    if any(row.cells["verdict"] != NOTHING for row in rows):
        notes.append(("", "vs full: final PSNR, compared as in the table of ablations."))
    if with_flicker:
        notes.append(FLICKER_NOTE)
    if motion:
        notes.append(MOTION_NOTE)
    notes += held_out_notes(present)
    notes += [("", note) for scene, note in split_notes if scene in set(present["scene"])]
    return Table(
        f"scenes_{family}", _FAMILY_TITLE[family], _columns(net, with_flicker, motion), tuple(rows), notes=tuple(notes)
    )


def _columns(net: str, with_flicker: bool, motion: Sequence[MotionColumn]) -> tuple[Column, ...]:
    return (
        Column("scene", "Scene", False),
        Column("train", "Schedule", False, fold=True),
        Column("ablation", "Model", False, fold=True),
        Column("seeds", "Seeds", fold=True),
        Column("final_psnr", "PSNR ↑ final", group="quality"),
        Column("best_psnr", "PSNR ↑ best on test", group="quality"),
        Column("full_minus", "full − this, PSNR", group="comparison"),
        Column("two_se", "2 SE", group="comparison"),
        Column("verdict", "vs full", False, group="comparison"),
        Column("final_ssim", "SSIM ↑ final", group="quality"),
        Column("best_ssim", "SSIM ↑ best on test", group="quality"),
        Column(f"final_lpips_{net}", f"LPIPS-{'Alex' if net == 'alex' else 'VGG'} ↓ final", group="quality"),
        *([Column("final_flicker", FLICKER_HEADER, group="quality")] if with_flicker else []),
        *(column.column for column in motion),
        Column("n_gaussians", "Gaussians", group="cost"),
        Column("train_seconds", "Train s", group="cost"),
    )


def _scene_cells(
    runs: pd.DataFrame, scene: str, ablation: str, train: str, net: str, motion: Sequence[MotionColumn]
) -> dict[str, Cell]:
    def cell(metric: str, decimals: int) -> Cell:
        return measured(over_seeds(runs, scene, ablation, train, metric), decimals)

    cells = {
        "seeds": number(len(select(runs, scene, ablation, train)), 0),
        "final_psnr": cell("final.psnr", 2),
        "best_psnr": cell("best_on_test.psnr", 2),
        "final_ssim": cell("final.ssim", 3),
        "best_ssim": cell("best_on_test.ssim", 3),
        f"final_lpips_{net}": cell(f"final.lpips_{net}", 3),
        "final_flicker": cell("final.flicker_levels", 2),
        **{column.key: cell(column.metric, column.decimals) for column in motion},
        "n_gaussians": cell("n_gaussians", 0),
        "train_seconds": cell("train_seconds", 0),
    }
    found = verdict(runs, scene, ablation, train, "final.psnr")
    if found is None:  # `full` itself, or no run of it
        return cells | dict.fromkeys(("full_minus", "two_se", "verdict"), NOTHING)
    return cells | {
        "full_minus": number(found.difference),
        "two_se": uncertainty(2 * found.standard_error),
        "verdict": text(found.word),
    }
