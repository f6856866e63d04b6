"""All tables of the report, as data. To add one, append it to TABLES; its files, its place on the page, and its notes
follow. What is no table of metrics is a class with `build` (time_to_psnr.py)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import pandas as pd

from pipeline.presentation.table import Table
from pipeline.report.ablation_grid import AblationGrid
from pipeline.report.paper_table import Averaged, PaperTable
from pipeline.report.run_table import RunTable, Shown, fewest_changes, full_model, shown
from pipeline.report.runs import BEST, RENDERED, Collection
from pipeline.report.scenes import DNERF, FAMILIES, FULL, MADE_FOR, PLENOPTIC, TABLE3, family, short


class Built(Protocol):
    def build(self, collection: Collection) -> Table | None: ...


def _made_for_ablation(runs: pd.DataFrame) -> pd.Series:
    """The runs of the scenes that an ablation was made for, of that ablation or of the full model."""
    pairs = {(made.scene, model) for made in MADE_FOR for model in (made.ablation, FULL)}
    found = pd.Series([pair in pairs for pair in zip(runs["scene"], runs["model"])], index=runs.index)
    return found & _rendered(runs)


def _rendered(runs: pd.DataFrame) -> pd.Series:
    """Of this program's own runs, which may have been packed and scored too."""
    return runs["images"] == RENDERED


def _of_family(name: str) -> Callable[[pd.DataFrame], pd.Series]:
    def chosen(runs: pd.DataFrame) -> pd.Series:
        return pd.Series([family(*row) == name for row in zip(runs["scene"], runs["capture"])], index=runs.index)

    return chosen


ABLATIONS = RunTable(
    "ablation_verdicts",
    "Ablations on the scenes made for them",
    ("scene_label", "protocol", "recipe_label", "model"),
    where=_made_for_ablation,
    columns=lambda: (Shown("psnr"), Shown("psnr", BEST)),
    against=full_model,
    baseline_name=FULL,
    differences=lambda: (Shown("psnr"), Shown("psnr", BEST)),
    only_compared=True,
    section="ablations",
    notes=tuple(f"{made.scene} is made for {made.ablation}: {made.reason}." for made in MADE_FOR),
)
_COMPARED = (
    *("psnr", "ssim", "psnr_moving", "psnr_still", "psnr_foreground", "flow_error", "lidar_error_median", "flicker"),
    *("train_seconds", "n_gaussians", "fps_render"),
)
COMPARE = RunTable(
    "compare",
    "Effect of changed settings",
    ("scene_label", "protocol", "model", "recipe_label"),
    where=_rendered,
    columns=lambda: (Shown("psnr"),),
    against=fewest_changes,
    baseline_name="unchanged",
    differences=lambda: tuple(map(Shown, _COMPARED)),
    verdicts=1,
    only_compared=True,
    across_scenes=True,
    notes=("A change of the scene belongs to the scene: runs of one size and with the same held-out views compare.",),
)
SCENES = tuple(
    RunTable(
        f"scenes_{name}",
        title,
        ("scene_label", "protocol", "recipe_label", "images", "model"),
        where=_of_family(name),
        columns=lambda: (
            Shown("psnr"),
            Shown("psnr", BEST),
            *(one for one in shown("quality", "region", "flow", "depth", "lidar", "flicker") if one.key != "psnr"),
            *(Shown(key) for key in ("n_gaussians", "train_seconds", "fps_render")),
        ),
        against=full_model,
        baseline_name=FULL,
        differences=lambda: (Shown("psnr"),),
        section="scenes",
    )
    for name, title in FAMILIES.items()
)
_ON_CPU = "FPS of our rows is of a CPU; the others' is of GPUs."
_OWN_SCENE = (
    "Resolution, length and held-out camera of our runs are those of the scene's configuration, unless changed."
)
PAPER = (
    PaperTable(
        "table1_plenoptic",
        "Table 1 · Plenoptic Video, mean over scenes",
        PLENOPTIC,
        tuple(
            Averaged(key, key, PLENOPTIC)
            for key in ("psnr", "psnr_channels", "dssim", "dssim1", "dssim2", "lpips_alex", "fps_render")
        ),
        notes=(_ON_CPU, _OWN_SCENE),
    ),
    PaperTable(
        "table1_per_scene",
        "Table 1 per scene · Plenoptic Video, PSNR",
        PLENOPTIC,
        (
            *(Averaged(short(scene), "psnr", (scene,), short(scene)) for scene in PLENOPTIC),
            Averaged("mean", "psnr", PLENOPTIC, "mean", complete=True),
        ),
        notes=(_OWN_SCENE,),
    ),
    PaperTable(
        "table2_dnerf",
        "Table 2 · D-NeRF, mean over scenes",
        DNERF,
        tuple(Averaged(key, key, DNERF) for key in ("psnr", "psnr_channels", "ssim", "lpips_vgg")),
    ),
    PaperTable(
        "table3_ablation",
        "Table 3 · Ablations on Plenoptic Video",
        TABLE3,
        (
            *(
                Averaged(f"{short(scene)}_{key}", key, (scene,), f"{short(scene)} {key.upper()} ↑")
                for scene in TABLE3
                for key in ("psnr", "ssim")
            ),
            *(
                Averaged(
                    f"mean_{key}",
                    key,
                    TABLE3,
                    f"average {key.upper()} ↑",
                    complete=True,
                    mean_of=tuple(f"{short(scene)}_{key}" for scene in TABLE3),
                )
                for key in ("psnr", "ssim")
            ),
        ),
        by_model=True,
        notes=(
            "The paper's average SSIM, and its average PSNR of no_4dsh, are computed here from its two scenes.",
            _OWN_SCENE,
        ),
    ),
)
RAW = (
    RunTable(
        "all_runs",
        "All runs",
        ("run", "protocol", "images", "model", "trained", "validation"),
        columns=lambda: (
            Shown("psnr"),
            Shown("psnr", BEST),
            *(one for one in shown("quality", "similarity", "region", "flow", "depth", "lidar") if one.key != "psnr"),
            *shown("flicker", "speed", "cost"),
        ),
        section="raw",
    ),
    RunTable(
        "provenance", "Provenance of all runs", ("run", "machine", "date", "git_commit", "command"), section="raw"
    ),
)
GRIDS = (AblationGrid("ablation_grid", "Ablations on the synthetic scenes, as in Table 3", "synthetic"),)
TABLES: tuple[Built, ...] = (ABLATIONS, *GRIDS, *PAPER, *SCENES, COMPARE, *RAW)
