"""Target pipeline.report: run folders, from files to tables and pages, without plots."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from hypothesis.strategies import SearchStrategy

from fuzz.edits.bytes import changed_files, edit_text
from fuzz.edits.json import edit_json
from fuzz.target import REFUSED, VALID, Changes, Files, Target, check_message, require, valid_or_refused
from fuzz.targets.data.dnerf import png
from pipeline.evaluation.metrics import METRICS
from pipeline.report.build import content_of, render_page
from pipeline.report.content import report_markdown, terminal_text
from pipeline.report.curve_figures import curve_figures
from pipeline.report.plots import end_of_coarse
from pipeline.report.runs import REQUIRED, collect, metric_columns

RUNS = ("synthetic/counter/full/fast/seed0", "synthetic/counter/no_4drot/fast/seed1")


def example() -> Files:
    files: Files = {}
    for seed, run in enumerate(RUNS):
        model = run.split("/")[2]
        quality = {
            **{key: 0.5 for key, metric in METRICS.items() if metric.group != "cost"},
            "psnr": 25.0 + seed,
            "lpips_alex": None,
            "lpips_note": "no weights",
        }
        metrics = {
            "final": quality,
            "best_on_test": {**quality, "iteration": 800},
            **{key: 10.0 for key, metric in METRICS.items() if metric.group == "cost"},
            "scene": "dnerf/lego",
            "recipe": "fast",
            "model": model,
            "changes": {"train.batch": seed + 1, "scene.downscale": 4},
            "seed": seed,
            "capture": "monocular",
            "kind": {"motion": "full", "fourier_order": seed, "sh_degree": 3},
            "decided": {"fourier_order": 0},
        }
        environment = {
            "machine": "2 cores",
            "date": "2025-01-01T10:00:00Z",
            "git_commit": "abc1234",
            "command": f"python -m pipeline scene=synthetic/counter seed={seed} train.batch={seed + 1}",
        }
        sfm = {
            "points": 12,
            "mean_error_px": 0.6,
            "mean_track_length": 3.5,
            "cameras": 2,
            "registered": 2,
            "seconds": 4.5,
            "poses": "known",
        }
        files |= {
            f"{run}/{name}": content.encode()
            for name, content in (
                ("metrics.json", json.dumps(metrics)),
                ("environment.json", json.dumps(environment)),
                ("sfm.json", json.dumps(sfm)),
                (
                    "config.yaml",
                    f"seed: {seed}\nscene:\n  name: dnerf/lego\n  path: a/b\n  validation_every: 0\n"
                    f"  test_split: val\nablation:\n  name: {model}\n  fourier_order: 1\n"
                    f"train:\n  name: fast\n  batch: {seed + 1}\n  iterations: 800\n"
                    "  resolution_steps:\n  - until: 0.5\n    scale: 0.5\n",
                ),
                (
                    "error_vs_time.csv",
                    "train_seconds,iteration,psnr,ssim,test_loss,n_gaussians\n"
                    "1.5,400,20.0,0.8,0.1,300\n3.0,800,25.0,0.9,,400\n",
                ),
                ("per_image.csv", "model,view,psnr\nfinal,test/r_0,25.0\n"),
            )
        }
        for part in ("render", "truth", "difference"):
            files[f"{run}/renders/test_r_0_{part}.png"] = png(seed, 6, 4, 3)
        files[f"{run}/sfm.png"] = png(seed, 6, 4, 3)
    return files


def changes(files: Files) -> SearchStrategy[Changes]:
    return changed_files(files, {".json": edit_json, ".yaml": edit_text, ".csv": edit_text})


def check(folder: Path) -> str:
    """An unreadable run is left out with a warning of one line; valid runs give tables and pages."""
    with valid_or_refused(folder):
        try:
            collected = collect(folder)
        except FileNotFoundError as error:
            check_message(str(error), str(folder))
            return REFUSED
        for line in (*collected.left_out, *collected.warnings):
            check_message(line, RUNS[0].split("/")[0], "")
        numbers = [*REQUIRED, *(column for column, _ in metric_columns())]
        require(not np.isinf(collected.runs[numbers].to_numpy(float)).any(), "an infinite number")
        curves = collected.curves[["train_seconds", "iteration", "psnr"]].to_numpy(float)
        require(bool(np.isfinite(curves).all()), "a curve value that is not finite")
        if collected.left_out or collected.warnings:
            return REFUSED
        content = content_of(collected)
        for line in content.warnings:
            check_message(line, "", "")
        for x in ("train_seconds", "iteration"):
            found = end_of_coarse(collected.curves, collected.settings, x)
            require(bool(np.isfinite(found)), "end_of_coarse is not finite")
        curve_figures(collected)
        for text in (report_markdown(content), terminal_text(content), render_page(content)):
            text.encode("utf-8")
    return VALID


TARGET = Target(
    "report", "run folders that the report reads: metrics, curves, settings, pictures", example, changes, check
)
