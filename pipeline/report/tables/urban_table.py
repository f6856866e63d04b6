"""The urban domain: driving logs, ours by scene, beside what others report of other clips."""

from __future__ import annotations

import pandas as pd

from pipeline.presentation.seed_statistics import over_seeds, select
from pipeline.presentation.table import Cell, Column, Row, Table, measured, printed, text
from pipeline.report.read import paper, scenes
from pipeline.report.tables.footnotes import PROTOCOL_NOTE, left_out_notes, missing_metric_notes
from pipeline.runs.read.collect import Collection

READERS = ("kitti", "waymo")
SYNTHETIC = ("synthetic/street",)
METRICS = {  # column -> (metric, header, decimals)
    "psnr": ("final.psnr", "PSNR ↑", 2),
    "ssim": ("final.ssim", "SSIM ↑", 3),
    "lpips": ("final.lpips_alex", "LPIPS-Alex ↓", 3),
    "psnr_moving": ("final.psnr_moving", "PSNR ↑ moving", 2),
    "psnr_still": ("final.psnr_still", "PSNR ↑ still", 2),
    "lidar_error": ("final.lidar_error_median", "Depth error ↓ median", 4),
    "lidar_error_mean": ("final.lidar_error_mean", "AbsRel ↓", 4),
    "lidar_rmse": ("final.lidar_rmse", "RMSE ↓, m", 2),
    "fps": ("final.fps_render", "FPS ↑", 0),
    "train_seconds": ("train_seconds", "Train s", 0),
}
PRINTED = ("psnr", "ssim", "lpips")  # what others report
OTHERS = (("Waymo, 4 clips", ""), ("KITTI, 3 clips", "kitti_"))  # of the table that Periodic Vibration Gaussian prints
NOTES = (
    (
        "",
        "Others: novel views with every fourth frame held out, as Periodic Vibration Gaussian (Chen et al., 2023) "
        "prints them; LPIPS as there. They are of other clips than ours and compare with none of our rows. The 4DGS "
        "paper prints no numbers of driving logs.",
    ),
    (
        "",
        "Depth error, AbsRel, RMSE: rendered depth against the LiDAR points of held-out sweeps that the view sees. "
        "Moving: by masks of the data, else by LiDAR points through whose place beams of other sweeps pass.",
    ),
)


def is_urban(scene: str) -> bool:
    return scene.split("/")[0] in READERS or scene in SYNTHETIC


def urban(collection: Collection) -> Table | None:
    """Every driving log × schedule × model, with the rule of the held-out frames; None without a run of one."""
    runs = collection.runs[collection.runs["scene"].map(is_urban)]
    if runs.empty:
        return None
    columns = (
        Column("method", "Method", False),
        Column("clip", "Clip", False),
        Column("held_out", "Held out", False),
        *(Column(key, header, ours_only=key not in PRINTED) for key, (_, header, _) in METRICS.items()),
    )
    rows = [
        Row(
            {"method": text(row["method"]), "clip": text(clip), "held_out": text("every 4th frame")}
            | {key: printed(row[f"{prefix}{key}"]) for key in PRINTED},
            "other",
        )
        for clip, prefix in OTHERS
        for row in paper.read("urban")
    ]
    for scene in scenes.in_order(runs["scene"]):
        of_scene = runs[runs["scene"] == scene]
        for train in sorted(of_scene["train"].unique()):
            for name in scenes.ablations_in_order(of_scene[of_scene["train"] == train]["ablation"]):
                rows.append(Row(_cells(of_scene, scene, name, train)))
    notes = (*NOTES, PROTOCOL_NOTE, *missing_metric_notes(runs, ("LPIPS",)), *left_out_notes(runs["ablation"]))
    return Table("urban", "Urban scenes · driving logs", columns, tuple(rows), notes=notes)


def _cells(runs: pd.DataFrame, scene: str, ablation: str, train: str) -> dict[str, Cell]:
    rules = sorted({rule or "unknown" for rule in select(runs, scene, ablation, train)["test_split"]})
    numbers = {
        key: measured(over_seeds(runs, scene, ablation, train, metric), decimals)
        for key, (metric, _, decimals) in METRICS.items()
    }
    head = {"method": text(f"Ours, {ablation}, {train}"), "clip": text(scene), "held_out": text("; ".join(rules))}
    return head | numbers
