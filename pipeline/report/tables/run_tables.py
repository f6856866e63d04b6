"""All tables of our own results in order; the tables of all runs and of their provenance."""

from __future__ import annotations

import math
from typing import Any

import pandas as pd

from pipeline.presentation.table import Cell, Column, Row, Table, number, text
from pipeline.report.tables.ablation_verdicts import ablation_verdicts
from pipeline.report.tables.changed_settings import changed_settings
from pipeline.report.tables.equal_time import equal_time
from pipeline.report.tables.footnotes import held_out_notes, left_out_notes, missing_metric_notes
from pipeline.report.tables.motion_columns import NOTE as MOTION_NOTE
from pipeline.report.tables.motion_columns import motion_columns
from pipeline.report.tables.scene_tables import scene_tables
from pipeline.report.tables.time_to_psnr import time_to_psnr
from pipeline.report.tables.urban_parts import urban_parts
from pipeline.report.tables.urban_table import urban
from pipeline.runs.read.collect import Collection

SELECTION_NOTE = (
    "Selection of 4DSH: PSNR gain from time-varying colour on validation views after a short training. Train s "
    "includes this training."
)


def run_tables(collection: Collection, levels: tuple[float, ...] = ()) -> list[Table]:
    """All tables of our own results in the order of the report, without those that have no rows.

    levels: dB, see time_to_psnr.
    """
    runs = collection.runs
    compared = equal_time(collection), time_to_psnr(collection, levels)
    found = [
        ablation_verdicts(runs),
        *scene_tables(collection),
        urban(collection),
        *compared,
        *changed_settings(collection),
        *urban_parts(collection),
        all_runs(runs),
        provenance(runs),
    ]
    return [table for table in found if table is not None]


def all_runs(runs: pd.DataFrame) -> Table:
    """Quality and cost, one row per run."""
    with_flicker, with_selection = runs["final.flicker"].notna().any(), runs["selection.gain"].notna().any()
    motion = motion_columns(runs)
    columns = (
        Column("run", "Run", False),
        Column("model", "Model", False, fold=True),
        Column("final_psnr", "PSNR final", group="quality"),
        Column("best_psnr", "PSNR best on test", group="quality"),
        Column("best_iteration", "at iteration", group="quality"),
        Column("final_ssim", "SSIM", group="quality"),
        Column("final_ms_ssim", "MS-SSIM", group="quality"),
        Column("final_dssim1", "DSSIM1", group="quality"),
        Column("final_dssim2", "DSSIM2", group="quality"),
        Column("final_lpips_alex", "LPIPS-Alex", group="quality"),
        Column("final_lpips_vgg", "LPIPS-VGG", group="quality"),
        *([Column("final_flicker", "Flicker, levels of 255", group="quality")] if with_flicker else []),
        *(column.column for column in motion),
        Column("fps_raster", "FPS raster", group="cost"),
        Column("fps_render", "FPS render", group="cost"),
        Column("iterations", "Iterations", fold=True, group="cost"),
        Column("train_seconds", "Train s", group="cost"),
        Column("n_gaussians", "Gaussians", group="cost"),
        Column("n_alive", "alive/frame", group="cost"),
        Column("model_mb", "Model MB", group="cost"),
        Column("model_with_optimiser_mb", "+ optimiser MB", group="cost"),
        Column("peak_rss_mb", "Peak RSS MB", group="cost"),
        *([Column("selection", "Selection of 4DSH, dB", False, group="cost")] if with_selection else []),
    )
    source = {
        "final_psnr": ("final.psnr", 2),
        "best_psnr": ("best_on_test.psnr", 2),
        "best_iteration": ("best_on_test.iteration", 0),
        "final_ssim": ("final.ssim", 4),
        "final_ms_ssim": ("final.ms_ssim", 4),
        "final_dssim1": ("final.dssim1", 4),
        "final_dssim2": ("final.dssim2", 4),
        "final_lpips_alex": ("final.lpips_alex", 3),
        "final_lpips_vgg": ("final.lpips_vgg", 3),
        "final_flicker": ("final.flicker_levels", 2),
        **{column.key: (column.metric, column.decimals) for column in motion},
        "fps_raster": ("final.fps_raster", 1),
        "fps_render": ("final.fps_render", 1),
        "iterations": ("iterations", 0),
        "train_seconds": ("train_seconds", 1),
        "n_gaussians": ("n_gaussians", 0),
        "n_alive": ("n_alive_mean", 0),
        "model_mb": ("model_mb", 1),
        "model_with_optimiser_mb": ("model_with_optimiser_mb", 1),
        "peak_rss_mb": ("peak_rss_mb", 0),
    }
    rows = tuple(
        Row(
            {
                "run": text(row["run"]),
                "model": text(row["ablation"]),
                **{key: number(row[metric], decimals) for key, (metric, decimals) in source.items()},
                "selection": _selection(row),
            }
        )
        for row in runs.to_dict("records")
    )
    return Table(
        "all_runs",
        "All runs",
        columns,
        rows,
        notes=(
            *missing_metric_notes(runs),
            ("", "FPS raster: blending only. FPS render: slicing, sorting and blending. Train s: without evaluation."),
            *([MOTION_NOTE] if motion else []),
            *([("", SELECTION_NOTE)] if with_selection else []),
            *left_out_notes(runs["ablation"]),
            *held_out_notes(runs),
        ),
        over_seeds=False,
    )


def _selection(run: dict[str, Any]) -> Cell:
    """The result of selecting time-varying colour by validation."""
    if math.isnan(run["selection.gain"]):
        return text("none")
    outcome = "kept" if run["selection.kept"] else "left out"
    return text(f"{run['selection.gain']:+.2f} ± {run['selection.standard_error']:.2f}: {outcome}")


def provenance(runs: pd.DataFrame) -> Table:
    """Machine, date, commit and command of every run."""
    columns = tuple(
        Column(key, header, False, fold=key in ("machine", "date", "git_commit"))
        for key, header in (
            ("run", "Run"),
            ("machine", "Machine"),
            ("date", "Date"),
            ("git_commit", "Commit"),
            ("command", "Command"),
        )
    )
    return Table(
        "provenance",
        "Provenance of all runs",
        columns,
        tuple(Row({column.key: text(str(row[column.key])) for column in columns}) for row in runs.to_dict("records")),
    )
