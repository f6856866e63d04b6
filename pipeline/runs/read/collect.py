"""Reads all run folders below a directory into data frames.

A run folder is any folder with a config.yaml or a metrics.json. A run that is unfinished or has an invalid metrics.json
is left out and named in one line. A missing or damaged other file (curve, provenance) gives a warning; the run stays.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from pipeline.runs.read.run_files import (
    CURVE_COLUMNS,
    CURVE_OPTIONAL,
    PROVENANCE,
    BrokenRun,
    read_curve,
    read_metrics,
    read_provenance,
    read_settings,
)

_EXPERIMENT = ("scene", "ablation", "train", "seed")
_HOW_TO_START = "give the folder of the runs, or start a run: python -m pipeline scene=synthetic/wheel train=fast"
_HOW_TO_RESUME = "to resume an interrupted run, repeat its command"


@dataclass(frozen=True)
class Collection:
    """The runs below a directory.

    runs: one row per run.
        run, folder: path below the directory, and whole path.
        scene, ablation, train, seed: as the run records them; name_variants makes ablation and train unambiguous.
        machine, date, git_commit, command, overrides: provenance.
        final.*, best_on_test.*: quality (floats; NaN: not measured). `*.dssim_ms` = (1 - MS-SSIM) / 2 is the paper's
        DSSIM; `*.flicker_levels` is flicker in levels of 255.
        n_gaussians, train_seconds, ...: cost (floats). lpips_note, ms_ssim_note: why a number is missing.
        selection.gain, selection.standard_error (dB; NaN: no selection), selection.kept: selection of 4DSH.
        model.motion ("": not recorded), model.fourier_order, model.sh_degree (NaN: not recorded): the trained model.
    curves: one row per evaluation: run, scene, ablation, train, seed, train_seconds (s), iteration, psnr (dB),
        n_gaussians, ssim, test_loss, psnr_moving (NaN: not measured).
    settings: run -> its resolved configuration, flattened to dotted keys.
    left_out: one line for each run that can't be used. warnings: one line for each file that can't be used.
    """

    runs: pd.DataFrame
    curves: pd.DataFrame
    settings: dict[str, dict[str, Any]]
    left_out: tuple[str, ...]
    warnings: tuple[str, ...]


def collect(runs_dir: Path) -> Collection:
    """All runs below `runs_dir`; FileNotFoundError if there is none that can be read."""
    if not runs_dir.is_dir():
        found = "a file" if runs_dir.exists() else "nothing"
        raise FileNotFoundError(f"{runs_dir}: expected a folder of runs, found {found}; {_HOW_TO_START}")
    rows, curves, settings = [], [], {}
    left_out: list[str] = []
    warnings: list[str] = []
    no_provenance = dict.fromkeys(PROVENANCE, "unknown") | {"overrides": ()}
    for folder in run_folders(runs_dir):
        run = folder.relative_to(runs_dir).as_posix()
        try:
            row = {"run": run, "folder": folder, **read_metrics(folder / "metrics.json")}
            config = read_settings(folder / "config.yaml")
        except BrokenRun as error:
            left_out.append(f"{run}: left out: {error}")
            continue
        row |= _or_warn(read_provenance, folder / "environment.json", no_provenance, run, warnings)
        rows.append(row)
        settings[run] = config
        if not config:
            warnings.append(f"{run}: no config.yaml: its settings are unknown")
        curve = _or_warn(read_curve, folder / "error_vs_time.csv", None, run, warnings)
        if curve is not None:
            curves.append(curve.assign(run=run, **{key: row[key] for key in _EXPERIMENT}))
    if not rows:
        found = f"none; {_HOW_TO_START}"
        if left_out:
            found = f"{len(left_out)} that cannot be used; the first: {left_out[0]}; {_HOW_TO_RESUME}"
        raise FileNotFoundError(f"{runs_dir}: expected at least one finished run (metrics.json), found {found}")
    no_curves = pd.DataFrame(columns=[*CURVE_COLUMNS, *CURVE_OPTIONAL, "run", *_EXPERIMENT])
    return Collection(
        runs=pd.DataFrame(rows),
        curves=pd.concat(curves, ignore_index=True) if curves else no_curves,
        settings=settings,
        left_out=tuple(left_out),
        warnings=tuple(warnings),
    )


def run_folders(runs_dir: Path) -> list[Path]:
    """Folders with a config.yaml or metrics.json, sorted, without hidden folders (Hydra's own)."""
    found = {path.parent for name in ("config.yaml", "metrics.json") for path in runs_dir.rglob(name)}
    return sorted(f for f in found if not any(part.startswith(".") for part in f.relative_to(runs_dir).parts))


def _or_warn(reader, path: Path, default: Any, run: str, warnings: list[str]) -> Any:
    try:
        return reader(path)
    except BrokenRun as error:
        warnings.append(f"{run}: {error}")
        return default
