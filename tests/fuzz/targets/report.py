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
from pipeline.report.compare.curve_figures import curve_figures
from pipeline.report.compare.curve_statistics import end_of_coarse
from pipeline.report.tables.paper_tables import paper_tables
from pipeline.report.tables.run_tables import run_tables
from pipeline.report.tables.summary import summarise
from pipeline.report.write.html_page import render_page
from pipeline.report.write.image_strips import make_strips
from pipeline.report.write.sections import Content, report_markdown, terminal_text
from pipeline.report.write.sfm_section import sfm_section
from pipeline.runs.read.collect import collect
from pipeline.runs.read.run_files import COST, PROTOCOLS, QUALITY, REQUIRED
from pipeline.runs.read.variants import name_variants

RUNS = ("synthetic/counter/full/fast/seed0", "synthetic/counter/no_4drot/fast/seed1")


def example() -> Files:
    files: Files = {}
    for seed, run in enumerate(RUNS):
        ablation = run.split("/")[2]
        quality = {**dict.fromkeys(QUALITY, 0.5), "psnr": 25.0 + seed, "lpips_alex": None, "lpips_note": "no weights"}
        metrics = {
            "final": quality,
            "best_on_test": {**quality, "iteration": 800},
            **dict.fromkeys(COST, 10.0),
            "scene": "dnerf/lego",
            "ablation": ablation,
            "train": "fast",
            "seed": seed,
            "trial": {"gain": 0.1, "standard_error": 0.2, "kept": False},
            "model": {"motion": "full", "fourier_order": seed, "sh_degree": 3},
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
                    f"  test_split: val\nablation:\n  name: {ablation}\n  fourier_order: 1\n"
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
        numbers = [*REQUIRED, *COST, *(f"{protocol}.{key}" for protocol in PROTOCOLS for key in QUALITY)]
        require(not np.isinf(collected.runs[numbers].to_numpy(float)).any(), "an infinite number")
        curves = collected.curves[["train_seconds", "iteration", "psnr"]].to_numpy(float)
        require(bool(np.isfinite(curves).all()), "a curve value that is not finite")
        if collected.left_out or collected.warnings:
            return REFUSED
        named = name_variants(collected)
        strips, strip_warnings = make_strips(named.runs)
        sfm, sfm_warnings = sfm_section(named.runs)
        for line in (*strip_warnings, *sfm_warnings):
            check_message(line, "", "")
        for x in ("train_seconds", "iteration"):
            require(bool(np.isfinite(end_of_coarse(named.curves, named.settings, x))), "end_of_coarse is not finite")
        curve_figures(named)
        content = Content(summarise(named, []), paper_tables(named), run_tables(named, ()), sfm, strips, [], [])
        for text in (report_markdown(content), terminal_text(content), render_page(content)):
            text.encode("utf-8")
    return VALID


TARGET = Target(
    "report", "run folders that the report reads: metrics, curves, settings, pictures", example, changes, check
)
