"""Our own tables: ablation verdicts, comparisons (their own modules), every run, where each number comes from."""

from __future__ import annotations

import math
from typing import Any

import pandas as pd

from . import scenes
from .aggregate import FORMULA, Verdict, select, trains, verdict
from .batches import batches
from .collect import PROTOCOLS, Collection
from .equal_time import equal_time
from .our_rows import PROTOCOL_NOTE, gap_notes
from .scene_tables import scene_tables
from .study import studies
from .table import Cell, Column, Row, Table, measured, number, text
from .time_to_psnr import time_to_psnr

TRIAL_NOTE = (
    "Trial of 4DSH: what colours that change with time gave held-out training views in a short training; a model "
    "whose trial left them out holds none, whatever its ablation. Train s: the trial's too."
)


def run_tables(collection: Collection, levels: tuple[float, ...] = ()) -> list[Table]:
    """All, in reading order; comparisons that there are no runs for are left out. levels: dB, see time_to_psnr."""
    runs = collection.runs
    compared = equal_time(collection), time_to_psnr(collection, levels), batches(collection)
    there = [table for table in compared if table is not None]
    return [verdicts(runs), *scene_tables(runs), *there, *studies(collection), all_runs(runs), provenance(runs)]


def verdicts(runs: pd.DataFrame) -> Table:
    """Is each ablation worse than `full` on the scene made for it?"""
    columns = (
        Column("ablation", "Ablation", False),
        Column("scene", "Made for it", False),
        Column("train", "Schedule", False),
        Column("protocol", "Model", False),
        Column("full_psnr", "full, PSNR"),
        Column("ablation_psnr", "ablation, PSNR"),
        Column("difference", "full − ablation"),
        Column("two_se", "2 SE"),
        Column("verdict", "Verdict", False),
    )
    rows = []
    for made in scenes.MADE_FOR:
        head = {"ablation": text(made.ablation), "scene": text(made.scene)}
        our_trains = trains(runs, [made.scene])
        for train in our_trains:
            for protocol in PROTOCOLS:
                rows.append(
                    Row(
                        head
                        | {"train": text(train), "protocol": text(protocol.replace("_", " "))}
                        | _verdict_cells(runs, made, train, f"{protocol}.psnr")
                    )
                )
        if not our_trains:
            rows.append(Row(head | {"verdict": text("no run")}))
    reasons = tuple(("", f"{made.scene} for {made.ablation}: {made.reason}.") for made in scenes.MADE_FOR)
    return Table(
        "ablation_verdicts",
        "Does each part earn its place? Ablations on the scenes made for them",
        columns,
        tuple(rows),
        caption=FORMULA,
        notes=reasons + (PROTOCOL_NOTE,),
    )


def _verdict_cells(runs: pd.DataFrame, made: scenes.MadeFor, train: str, metric: str) -> dict[str, Cell]:
    found = verdict(runs, made.scene, made.ablation, train, metric)
    if found is None:
        lacking = [name for name in ("full", made.ablation) if select(runs, made.scene, name, train).empty]
        return {"verdict": text(f"no run of {' and '.join(lacking)}" if lacking else "not measured")}
    return {
        "full_psnr": measured(found.full),
        "ablation_psnr": measured(found.ablation),
        "difference": number(found.difference),
        "two_se": number(2 * found.standard_error),
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


def all_runs(runs: pd.DataFrame) -> Table:
    """One row a run: quality and cost."""
    filmed, tried = runs["final.flicker"].notna().any(), runs["trial.gain"].notna().any()
    columns = (
        Column("run", "Run", False),
        Column("final_psnr", "PSNR final"),
        Column("best_psnr", "PSNR best on test"),
        Column("best_iteration", "at iteration"),
        Column("final_ssim", "SSIM"),
        Column("final_ms_ssim", "MS-SSIM"),
        Column("final_dssim1", "DSSIM1"),
        Column("final_dssim2", "DSSIM2"),
        Column("final_lpips_alex", "LPIPS-Alex"),
        Column("final_lpips_vgg", "LPIPS-VGG"),
        *([Column("final_flicker", "Flicker, levels of 255")] if filmed else []),
        Column("fps_raster", "FPS raster"),
        Column("fps_render", "FPS render"),
        Column("iterations", "Iterations"),
        Column("train_seconds", "Train s"),
        Column("n_gaussians", "Gaussians"),
        Column("n_alive", "alive/frame"),
        Column("model_mb", "Model MB"),
        Column("model_with_optimiser_mb", "+ optimiser MB"),
        Column("peak_rss_mb", "Peak RSS MB"),
        *([Column("trial", "Trial of 4DSH, dB", False)] if tried else []),
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
                **{key: number(row[metric], decimals) for key, (metric, decimals) in source.items()},
                "trial": _trial(row),
            }
        )
        for row in runs.to_dict("records")
    )
    return Table(
        "all_runs",
        "Every run",
        columns,
        rows,
        notes=(
            *gap_notes(runs),
            (
                "",
                "FPS raster: blending alone; FPS render: with slicing, sorting. Train s: without evaluation.",
            ),
            *([("", TRIAL_NOTE)] if tried else []),
        ),
    )


def _trial(run: dict[str, Any]) -> Cell:
    """What a run's trial said."""
    if math.isnan(run["trial.gain"]):
        return text("none")
    said = "kept" if run["trial.kept"] else "left out"
    return text(f"{run['trial.gain']:+.2f} ± {run['trial.standard_error']:.2f}: {said}")


def provenance(runs: pd.DataFrame) -> Table:
    """Machine, date, commit and command of every run."""
    columns = tuple(
        Column(key, header, False)
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
        "Where the numbers come from",
        columns,
        tuple(
            Row({column.key: text(str(row[column.key])) for column in columns})
            for row in runs.to_dict("records")
        ),
    )
