"""Reads and checks the files of one run folder: metrics, learning curve, provenance, settings, sfm.json."""

from __future__ import annotations

import io
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pandas as pd

from datasets.files.errors import DataError, clear
from pipeline.config.schema import MAX_SEED
from pipeline.runs.run_identity import read_config

PROTOCOLS = ("final", "best_on_test")  # the last iteration; the best test evaluation, as in the authors' release
QUALITY = (
    "psnr",
    "ssim",
    "ms_ssim",
    "dssim1",
    "dssim2",
    "lpips_alex",
    "lpips_vgg",
    "psnr_moving",
    "psnr_still",
    "psnr_foreground",
    "psnr_masked",
    "flow_error",
    "flow_error_px",
    "flow_true_px",
    "depth_error_median",
    "depth_error_mean",
    "lidar_error_median",
    "lidar_error_mean",
    "lidar_rmse",
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
CURVE_OPTIONAL = ("ssim", "test_loss", "psnr_moving")
PROVENANCE = ("machine", "date", "git_commit", "command")
MOTIONS = ("static", "separable", "full")  # of rasterizer.gaussians.Motion, after training
SFM_NUMBERS = ("points", "mean_error_px", "mean_track_length", "cameras", "registered", "seconds")
SFM_POSES = ("known", "refined", "estimated")
MAX_NUMBER = 1e15  # of a measurement; its square is finite too
MAX_TEXT = 4000  # characters of a note or a command


class BrokenRun(ValueError):
    """A run folder that can't be used; the message is one line with the expected and the found value."""

    def __init__(self, message: str) -> None:
        super().__init__(clear(message))


def read_metrics(path: Path) -> dict[str, Any]:
    """metrics.json, checked and flattened to keys such as `final.psnr`. Floats; null becomes NaN."""
    if not path.is_file():
        raise BrokenRun("unfinished: no metrics.json")
    # Reports are published: a note may name files in the user's home folder.
    data = _object(path, lambda text: text.replace(str(Path.home()), "~"))
    row: dict[str, Any] = {}
    for key in ("scene", "ablation", "train"):
        row[key] = data.get(key)
        if not isinstance(row[key], str) or not row[key] or clear(row[key]) != row[key]:
            raise BrokenRun(f"metrics.json: {key}: expected a name, found {row[key]!r}")
    row["seed"] = data.get("seed")
    if not isinstance(row["seed"], int) or isinstance(row["seed"], bool) or not 0 <= row["seed"] <= MAX_SEED:
        raise BrokenRun(f"metrics.json: seed: expected an integer in 0..{MAX_SEED}, found {row['seed']!r}")
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
    selection = data.get("select_time_colour") or data.get("trial") or {}  # `trial` up to version 0.1
    if not isinstance(selection, dict):
        raise BrokenRun(f"metrics.json: select_time_colour: expected an object, found {selection!r}")
    for key in ("gain", "standard_error"):
        row[f"selection.{key}"] = _number(selection.get(key), f"select_time_colour.{key}")
    row["selection.kept"] = selection.get("kept") is True
    row |= _model(data.get("model"), left_out=selection.get("kept") is False)
    motion = data.get("select_motion") or {}
    if not isinstance(motion, dict):
        raise BrokenRun(f"metrics.json: select_motion: expected an object, found {motion!r}")
    row["found_static"] = motion.get("dynamic") is False
    row["test_split"] = _text(data.get("test_split"))
    for key in ("lpips_note", "ms_ssim_note"):  # the reason for a missing number
        row[key] = _text(data["final"].get(key))
    return row


def _model(model: Any, left_out: bool) -> dict[str, Any]:
    """The trained model. Older runs do not record it; of those only `left_out` (4DSH removed by selection) is known."""
    if model is None:
        return {"model.motion": "", "model.fourier_order": 0.0 if left_out else math.nan, "model.sh_degree": math.nan}
    if not isinstance(model, dict):
        raise BrokenRun(f"metrics.json: model: expected an object, found {model!r}")
    if model.get("motion") not in MOTIONS:
        raise BrokenRun(f"metrics.json: model.motion: expected {', '.join(MOTIONS)}, found {model.get('motion')!r}")
    return {"model.motion": model["motion"]} | {
        f"model.{key}": _number(model.get(key), f"model.{key}") for key in ("fourier_order", "sh_degree")
    }


def read_curve(path: Path) -> pd.DataFrame:
    """error_vs_time.csv, one row per evaluation. An incomplete last line (interrupted run) is dropped."""
    if not path.is_file():
        raise BrokenRun(f"no {path.name}")
    try:
        lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
        complete = lines if not lines or lines[-1].endswith("\n") else lines[:-1]
        # pandas would read the extra leading fields of a longer line as an index and shift the columns.
        longer = [i for i, line in enumerate(complete, 1) if line.count(",") > complete[0].count(",")]
        if longer:
            raise BrokenRun(f"{path.name}: expected as many columns as in the first line, found more in {longer[0]}")
        curve = pd.read_csv(io.StringIO("".join(complete)))
    except BrokenRun:
        raise
    except (ValueError, OverflowError, OSError) as error:  # pandas raises subclasses of ValueError
        raise BrokenRun(f"{path.name}: expected a CSV table, found {error}") from None
    missing = [c for c in CURVE_COLUMNS if c not in curve]
    if missing:
        raise BrokenRun(f"{path.name}: expected columns {', '.join(CURVE_COLUMNS)}; missing {', '.join(missing)}")
    numbers = curve[list(CURVE_COLUMNS)].apply(pd.to_numeric, errors="coerce")
    wrong = ~(numbers.abs() <= MAX_NUMBER)  # true for NaN
    if numbers.empty or wrong.any(axis=None):
        bad = "no rows" if numbers.empty else f"none in line {2 + int(wrong.any(axis=1).idxmax())}"
        raise BrokenRun(f"{path.name}: expected numbers, found {bad}")
    optional = curve.reindex(columns=list(CURVE_OPTIONAL)).apply(pd.to_numeric, errors="coerce")
    return numbers.join(optional).sort_values("iteration", kind="stable").reset_index(drop=True)


def read_provenance(path: Path) -> dict[str, Any]:
    """environment.json: the PROVENANCE keys as text (`unknown` where missing) and `overrides`, a tuple of `key=value`.

    Older runs recorded the shell command but no overrides; theirs is empty.
    """
    if not path.is_file():
        raise BrokenRun(f"no {path.name}: machine and date unknown")
    data = _object(path)
    overrides = data.get("overrides")
    overrides = tuple(map(_text, overrides)) if isinstance(overrides, list) else ()
    return {key: _text(data.get(key)) or "unknown" for key in PROVENANCE} | {"overrides": overrides}


def read_settings(path: Path) -> dict[str, Any]:
    """config.yaml flattened to dotted keys (`train.densify.every`: 100); empty where the run has none."""
    if not path.is_file():
        return {}
    try:
        tree = read_config(path, path.name)
    except DataError as error:
        raise BrokenRun(str(error)) from None
    flat: dict[str, Any] = {}

    def flatten(prefix: str, node: Any) -> None:
        if isinstance(node, dict) and node:
            for key, value in node.items():
                flatten(f"{prefix}.{_text(str(key))}" if prefix else _text(str(key)), value)
        else:
            flat[prefix] = _text(node) if isinstance(node, str) else node

    flatten("", tree)
    return flat


def read_sfm(path: Path) -> dict[str, Any]:
    """sfm.json: SFM_NUMBERS as finite numbers and `poses`, one of SFM_POSES."""
    data = _object(path)
    for key in SFM_NUMBERS:
        if not _is_number(data.get(key)):
            raise BrokenRun(f"{path.name}: {key}: expected a finite number, found {data.get(key)!r}")
    if data.get("poses") not in SFM_POSES:
        raise BrokenRun(f"{path.name}: poses: expected {', '.join(SFM_POSES)}, found {data.get('poses')!r}")
    return {key: data[key] for key in (*SFM_NUMBERS, "poses")}


def read_view_psnr(path: Path) -> dict[str, float]:
    """per_image.csv: PSNR of the final model by view (`/` as `_`, as in file names); empty if it can't be read."""
    try:
        table = pd.read_csv(path)
    except (OSError, ValueError, OverflowError):
        return {}
    if not {"view", "psnr"} <= set(table):
        return {}
    if "model" in table:
        table = table[table["model"] == "final"]
    return {
        str(view).replace("/", "_"): float(psnr)
        for view, psnr in zip(table["view"], pd.to_numeric(table["psnr"], errors="coerce"))
        if psnr == psnr
    }


def _object(path: Path, preprocess: Callable[[str], str] = str) -> dict[str, Any]:
    """The object in a JSON file, whose text `preprocess` may change first."""
    try:
        data = json.loads(preprocess(path.read_text(encoding="utf-8")))
    except (ValueError, RecursionError, OSError) as error:  # not UTF-8, not JSON, an integer too long; nested too deep
        raise BrokenRun(f"{path.name}: expected JSON, found {error}") from None
    if not isinstance(data, dict):
        raise BrokenRun(f"{path.name}: expected an object, found {type(data).__name__}")
    return data


def _text(value: Any) -> str:
    """One line of printable text; empty for None."""
    return clear(value, MAX_TEXT) if value else ""


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) <= MAX_NUMBER


def _number(value: Any, key: str) -> float:
    """A finite float; NaN for None."""
    if value is None:
        return math.nan
    if not _is_number(value):
        raise BrokenRun(f"metrics.json: {key}: expected a finite number, found {value!r}")
    return float(value)
