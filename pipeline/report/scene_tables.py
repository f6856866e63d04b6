"""A table a family of scenes: every scene × schedule × ablation."""

from __future__ import annotations

import pandas as pd

from . import scenes
from .aggregate import over_seeds, select, verdict
from .our_rows import FLICKER_HEADER, FLICKER_NOTE, PROTOCOL_NOTE, gap_notes
from .table import Cell, Column, Row, Table, measured, number, text

_FAMILY_TITLE = {
    "synthetic": "Synthetic suite",
    "dnerf": "D-NeRF per scene",
    "plenoptic": "Plenoptic Video in detail",
    "other": "Other scenes",
}
_LPIPS_NET = {"plenoptic": "alex"}  # the literature's on Plenoptic Video; on D-NeRF and so on ours it is VGG


def scene_tables(runs: pd.DataFrame) -> list[Table]:
    """In reading order; a family without runs is left out, except D-NeRF: its rows are empty."""
    return [
        scene_table(runs, family)
        for family in _FAMILY_TITLE
        if family == "dnerf" or (runs["scene"].map(scenes.family) == family).any()
    ]


def scene_table(runs: pd.DataFrame, family: str) -> Table:
    """Every scene of a family × schedule × ablation, `final` and `best on test` side by side."""
    present = runs[runs["scene"].map(scenes.family) == family]
    filmed, net = present["final.flicker"].notna().any(), _LPIPS_NET.get(family, "vgg")
    columns = (
        Column("scene", "Scene", False),
        Column("train", "Schedule", False),
        Column("ablation", "Ablation", False),
        Column("seeds", "Seeds"),
        Column("final_psnr", "PSNR ↑ final"),
        Column("best_psnr", "PSNR ↑ best on test"),
        Column("full_minus", "full − this, PSNR"),
        Column("two_se", "2 SE"),
        Column("verdict", "vs full", False),
        Column("final_ssim", "SSIM ↑ final"),
        Column("best_ssim", "SSIM ↑ best on test"),
        Column(f"final_lpips_{net}", f"LPIPS-{'Alex' if net == 'alex' else 'VGG'} ↓ final"),
        *([Column("final_flicker", FLICKER_HEADER)] if filmed else []),
        Column("n_gaussians", "Gaussians"),
        Column("train_seconds", "Train s"),
    )
    listed = scenes.DNERF if family == "dnerf" else scenes.in_order(present["scene"])
    rows = []
    for scene in listed:
        of_scene = present[present["scene"] == scene]
        if of_scene.empty:
            rows.append(Row({"scene": text(scene)}))
        for train in sorted(of_scene["train"].unique()):
            names = of_scene[of_scene["train"] == train]["ablation"]
            for name in scenes.ablations_in_order(names):
                rows.append(
                    Row(
                        {"scene": text(scene), "train": text(train), "ablation": text(name)}
                        | _scene_cells(of_scene, scene, name, train, net)
                    )
                )
    notes = [PROTOCOL_NOTE, *gap_notes(present)]
    if any("verdict" in row.cells for row in rows):
        notes.append(("", "vs full: final PSNR, by the rule of the ablation verdicts."))
    if filmed:
        notes.append(FLICKER_NOTE)
    return Table(f"scenes_{family}", _FAMILY_TITLE[family], columns, tuple(rows), notes=tuple(notes))


def _scene_cells(runs: pd.DataFrame, scene: str, ablation: str, train: str, net: str) -> dict[str, Cell]:
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
        "n_gaussians": cell("n_gaussians", 0),
        "train_seconds": cell("train_seconds", 0),
    }
    found = verdict(runs, scene, ablation, train, "final.psnr") if ablation != "full" else None
    if found is None:
        dash = text("·")  # nothing to compare: this is `full`, or `full` has no run
        return cells | {"full_minus": dash, "two_se": dash, "verdict": dash}
    return cells | {
        "full_minus": number(found.difference),
        "two_se": number(2 * found.standard_error),
        "verdict": text(found.word),
    }
