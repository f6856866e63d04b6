"""Reads run folders into tidy frames.

A run folder is any folder with a config.yaml or a metrics.json. One that is unfinished or whose metrics.json
can't be trusted is named in one line and left out; a missing or damaged side file (curve, provenance) is a
warning and the run stays, without that part.
"""

from __future__ import annotations

import io
import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from datasets.files.errors import DataError, clear
from pipeline.runs.run_identity import read_config

PROTOCOLS = ("final", "best_on_test")  # the last iteration; the release's pick among the test evaluations
QUALITY = (
    "psnr",
    "ssim",
    "ms_ssim",
    "dssim1",
    "dssim2",
    "lpips_alex",
    "lpips_vgg",
    "flicker",
    "fps_raster",
    "fps_render",
)
COST = (
    "iterations",
    "train_seconds",
    "n_gaussians",
    "n_alive_mean",
    "peak_rss_mb",
    "model_mb",
    "model_with_optimiser_mb",
)
REQUIRED = ("final.psnr", "final.ssim", "iterations", "train_seconds", "n_gaussians")
CURVE_COLUMNS = ("train_seconds", "iteration", "psnr", "n_gaussians")
CURVE_MORE = ("ssim", "test_loss")  # a curve without them is drawn without them
PROVENANCE = ("machine", "date", "git_commit", "command")  # these stand beside the numbers
MOTIONS = ("static", "separable", "full")  # rasterizer.gaussians.Motion
LARGEST_NUMBER = 1e15  # of a measurement; its square is a number too
LARGEST_SEED = 2**63 - 1  # of pandas
_MAKE_ONE = "give the folder runs were written to, or make one: python -m pipeline scene=synthetic/wheel train=fast"
_FINISH_IT = "an interrupted run goes on when its command is given again"
LONGEST_NOTE = 4000  # characters, of a command too


class BrokenRun(ValueError):
    """A run folder that can't be used; the message is one line: what was expected, what was found."""

    def __init__(self, message: str) -> None:
        super().__init__(clear(message))


@dataclass(frozen=True)
class Collection:
    """Everything the report knows.

    runs:     one row a run: run (its path under RUNS_DIR), folder, scene, ablation, train, seed, machine,
              date, git_commit, command, *_note, and the metrics as `final.psnr`, `best_on_test.psnr`,
              `n_gaussians` … (floats; NaN: not measured), `selection.gain` and `selection.standard_error` (dB; NaN:
              no selection), `selection.kept`. `*.dssim_ms` = (1 - MS-SSIM) / 2 is the paper's
              DSSIM; `*.flicker_levels` is flicker in levels of 255. `model.motion` (one of MOTIONS; "": not said),
              `model.fourier_order`, `model.sh_degree` (floats; NaN: not said): the model that was trained. As collect
              returns them, ablation and train are the names the run gives itself; name_variants makes them true
    curves:   one row an evaluation: run, scene, ablation, train, seed, train_seconds (s), iteration,
              psnr (dB), n_gaussians, and ssim, test_loss (NaN: not measured)
    settings: run -> its resolved config, flattened to `train.densify.every` style keys
    left_out: one line for each run not used;  warnings: one line for each part of a run not used
    """

    runs: pd.DataFrame
    curves: pd.DataFrame
    settings: dict[str, dict[str, Any]]
    left_out: tuple[str, ...]
    warnings: tuple[str, ...]


def collect(runs_dir: Path) -> Collection:
    """Reads every run folder under `runs_dir`; FileNotFoundError if there is none that can be read."""
    if not runs_dir.is_dir():
        found = "a file" if runs_dir.exists() else "nothing"
        raise FileNotFoundError(f"{runs_dir}: expected a folder of runs, found {found}; {_MAKE_ONE}")
    rows, curves, settings = [], [], {}
    left_out, warnings = [], []
    for folder in run_folders(runs_dir):
        run = folder.relative_to(runs_dir).as_posix()
        try:
            row = {"run": run, "folder": folder, **read_metrics(folder / "metrics.json")}
            config = read_settings(folder / "config.yaml")
        except BrokenRun as error:
            left_out.append(f"{run}: left out: {error}")
            continue
        row |= _or_warn(
            read_provenance,
            folder / "environment.json",
            dict.fromkeys(PROVENANCE, "unknown") | {"overrides": ()},
            run,
            warnings,
        )
        rows.append(row)
        settings[run] = config
        if not config:
            warnings.append(f"{run}: no config.yaml: settings taken to be those its name says")
        curve = _or_warn(read_curve, folder / "error_vs_time.csv", None, run, warnings)
        if curve is not None:
            curves.append(curve.assign(run=run, **{key: row[key] for key in ("scene", "ablation", "train", "seed")}))
    if not rows:
        raise FileNotFoundError(
            f"{runs_dir}: expected at least one finished run (metrics.json), found "
            + (
                f"{len(left_out)} that cannot be used; the first: {left_out[0]}; {_FINISH_IT}"
                if left_out
                else f"none; {_MAKE_ONE}"
            )
        )
    return Collection(
        runs=pd.DataFrame(rows),
        curves=pd.concat(curves, ignore_index=True)
        if curves
        else pd.DataFrame(columns=[*CURVE_COLUMNS, *CURVE_MORE, "run", "scene", "ablation", "train", "seed"]),
        settings=settings,
        left_out=tuple(left_out),
        warnings=tuple(warnings),
    )


def run_folders(runs_dir: Path) -> list[Path]:
    """Folders with a config.yaml or metrics.json, sorted; hidden folders (Hydra's own) are passed over."""
    found = {path.parent for name in ("config.yaml", "metrics.json") for path in runs_dir.rglob(name)}
    return sorted(f for f in found if not any(part.startswith(".") for part in f.relative_to(runs_dir).parts))


def read_metrics(path: Path) -> dict[str, Any]:
    """metrics.json, checked and flattened: `final.psnr` … as float, null as NaN."""
    if not path.is_file():
        raise BrokenRun("unfinished: no metrics.json")
    # A report is passed on: notes that name files under somebody's home folder keep it to themselves.
    data = _object(path, lambda text: text.replace(str(Path.home()), "~"))
    row: dict[str, Any] = {}
    for key in ("scene", "ablation", "train"):
        row[key] = data.get(key)
        if not isinstance(row[key], str) or not row[key] or clear(row[key]) != row[key]:
            raise BrokenRun(f"metrics.json: {key}: expected a name, found {row[key]!r}")
    row["seed"] = data.get("seed")
    if not isinstance(row["seed"], int) or isinstance(row["seed"], bool) or not 0 <= row["seed"] <= LARGEST_SEED:
        raise BrokenRun(f"metrics.json: seed: expected an integer in 0..{LARGEST_SEED}, found {row['seed']!r}")
    for protocol in PROTOCOLS:
        part = data.get(protocol) or {}
        if not isinstance(part, dict):
            raise BrokenRun(f"metrics.json: {protocol}: expected an object, found {part!r}")
        for key in QUALITY + (("iteration",) if protocol == "best_on_test" else ()):
            row[f"{protocol}.{key}"] = _number(part.get(key), f"{protocol}.{key}")
        row[f"{protocol}.dssim_ms"] = (1 - row[f"{protocol}.ms_ssim"]) / 2
        row[f"{protocol}.flicker_levels"] = 255 * row[f"{protocol}.flicker"]
    for key in COST:
        row[key] = _number(data.get(key), key)
    for key in REQUIRED:
        if math.isnan(row[key]):
            raise BrokenRun(f"metrics.json: {key}: expected a number, found none")
    selection = data.get("select_time_colour") or data.get("trial") or {}  # its name up to version 0.1
    if not isinstance(selection, dict):
        raise BrokenRun(f"metrics.json: select_time_colour: expected an object, found {selection!r}")
    for key in ("gain", "standard_error"):
        row[f"selection.{key}"] = _number(selection.get(key), f"select_time_colour.{key}")
    row["selection.kept"] = selection.get("kept") is True
    row |= _model(data.get("model"), left_out=selection.get("kept") is False)
    for key in ("lpips_note", "ms_ssim_note"):  # why a number is missing
        row[key] = _note(data["final"].get(key))
    return row


def _model(said: Any, left_out: bool) -> dict[str, Any]:
    """The trained model; of a run that does not say it, no more is known than that selection left 4DSH out."""
    if said is None:
        return {"model.motion": "", "model.fourier_order": 0.0 if left_out else math.nan, "model.sh_degree": math.nan}
    if not isinstance(said, dict):
        raise BrokenRun(f"metrics.json: model: expected an object, found {said!r}")
    if said.get("motion") not in MOTIONS:
        raise BrokenRun(f"metrics.json: model.motion: expected {', '.join(MOTIONS)}, found {said.get('motion')!r}")
    return {"model.motion": said["motion"]} | {
        f"model.{key}": _number(said.get(key), f"model.{key}") for key in ("fourier_order", "sh_degree")
    }


def read_curve(path: Path) -> pd.DataFrame:
    """error_vs_time.csv, one row an evaluation; a last line without an end, cut by a kill, is dropped."""
    if not path.is_file():
        raise BrokenRun(f"no {path.name}")
    try:
        lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
        whole = lines if not lines or lines[-1].endswith("\n") else lines[:-1]
        # pandas takes what longer lines have in front for an index, and so shifts the columns.
        longer = [number for number, line in enumerate(whole, 1) if line.count(",") > whole[0].count(",")]
        if longer:
            raise BrokenRun(f"{path.name}: expected as many columns as in the first line, found more in {longer[0]}")
        curve = pd.read_csv(io.StringIO("".join(whole)))
    except BrokenRun:
        raise
    except (ValueError, OverflowError, OSError) as error:  # pandas' own are among the first
        raise BrokenRun(f"{path.name}: expected a CSV table, found {error}") from None
    missing = [c for c in CURVE_COLUMNS if c not in curve]
    if missing:
        raise BrokenRun(f"{path.name}: expected columns {', '.join(CURVE_COLUMNS)}; missing {', '.join(missing)}")
    numbers = curve[list(CURVE_COLUMNS)].apply(pd.to_numeric, errors="coerce")
    wrong = ~(numbers.abs() <= LARGEST_NUMBER)  # NaN, too
    if numbers.empty or wrong.any(axis=None):
        bad = "no rows" if numbers.empty else f"none in line {2 + int(wrong.any(axis=1).idxmax())}"
        raise BrokenRun(f"{path.name}: expected numbers, found {bad}")
    more = curve.reindex(columns=list(CURVE_MORE)).apply(pd.to_numeric, errors="coerce")
    return numbers.join(more).sort_values("iteration", kind="stable").reset_index(drop=True)


def read_provenance(path: Path) -> dict[str, Any]:
    """machine, date, git_commit and command of environment.json; `unknown` where one is not there. And `overrides`, the
    command line's as a tuple; empty where they are not recorded."""
    if not path.is_file():
        raise BrokenRun(f"no {path.name}: machine and date unknown")
    data = _object(path)
    overrides = data.get("overrides")
    overrides = tuple(map(_note, overrides)) if isinstance(overrides, list) else ()
    return {key: _note(data.get(key)) or "unknown" for key in PROVENANCE} | {"overrides": overrides}


def read_settings(path: Path) -> dict[str, Any]:
    """config.yaml flattened to `train.densify.every: 100`; empty if the run has none."""
    if not path.is_file():
        return {}
    try:
        tree = read_config(path, path.name)
    except DataError as error:
        raise BrokenRun(str(error)) from None
    flat: dict[str, Any] = {}

    def walk(prefix: str, node: Any) -> None:
        if isinstance(node, dict) and node:
            for key, value in node.items():
                walk(f"{prefix}.{_note(str(key))}" if prefix else _note(str(key)), value)
        else:
            flat[prefix] = _note(node) if isinstance(node, str) else node

    walk("", tree)
    return flat


def _object(path: Path, prepared: Callable[[str], str] = str) -> dict[str, Any]:
    """The object a JSON file holds. prepared: what is done to its text first."""
    try:
        data = json.loads(prepared(path.read_text(encoding="utf-8")))
    except (ValueError, RecursionError, OSError) as error:  # no text, no JSON, a number of 5,000 digits; too deep
        raise BrokenRun(f"{path.name}: expected JSON, found {error}") from None
    if not isinstance(data, dict):
        raise BrokenRun(f"{path.name}: expected an object, found {type(data).__name__}")
    return data


def _note(value: Any) -> str:
    """A text to be shown; empty where there is none."""
    return clear(value, LONGEST_NOTE) if value else ""


def _number(value: Any, key: str) -> float:
    """A finite float, or NaN for null and absent; anything else breaks the run."""
    if value is None:
        return math.nan
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) <= LARGEST_NUMBER:
        raise BrokenRun(f"metrics.json: {key}: expected a finite number, found {value!r}")
    return float(value)


def _or_warn(reader, path: Path, default: Any, run: str, warnings: list[str]) -> Any:
    try:
        return reader(path)
    except BrokenRun as error:
        warnings.append(f"{run}: {error}")
        return default
