"""Reads all run folders below one or more folders into data frames.

A run folder is any folder with a config.yaml or a metrics.json. Every run declares in metrics.json what it is: scene,
recipe, model, changes and seed. A run that is unfinished or whose metrics.json is invalid is left out and named in one
line. A missing or damaged other file (curve, provenance) gives a warning; the run stays.
"""

from __future__ import annotations

import io
import json
import math
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import pandas as pd

from datasets.files.errors import DataError, clear
from datasets.scene import Capture
from pipeline.config.schema import MAX_SEED
from pipeline.evaluation.metrics import METRICS
from pipeline.evaluation.protocol import UNRECORDED
from pipeline.runs.run_identity import flat, read_config

FINAL, BEST = "final", "best_on_test"  # the last iteration; the best test evaluation, as in the authors' release
QUALITY = ("final.psnr", "final.ssim")
REQUIRED = (*QUALITY, "iterations", "train_seconds", "n_gaussians")
CURVE_COLUMNS = ("train_seconds", "iteration", "psnr", "n_gaussians")
CURVE_OPTIONAL = ("cpu_seconds", "ssim", "test_loss", "psnr_moving")
PROVENANCE = ("machine", "date", "git_commit", "command")
NOTES = ("lpips_note", "ms_ssim_note")  # why a number is missing
RENDERED, GIVEN = IMAGES = ("rendered", "given")  # by this program, or by anyone (pipeline.score)
IDENTITY = (
    "scene_label",
    "protocol",
    "recipe_label",
    "images",
    "model",
    "seed",
)  # runs that are equal in these are repetitions
CPU = ("threads", "multiply_adds_per_s", "bytes_per_s")  # of training: what one thread achieves at most
MAX_NUMBER = 1e15  # of a measurement; its square is finite too
MAX_TEXT = 4000  # characters of a note or a command

_HOW_TO_START = "give the folder of the runs, or start a run: python -m pipeline scene=synthetic/wheel train=fast"
_HOW_TO_RESUME = "to resume an interrupted run, repeat its command"


class BrokenRun(ValueError):
    """A run folder that can't be used; the message is one line with the expected and the found value."""

    def __init__(self, message: str) -> None:
        super().__init__(clear(message))


@dataclass(frozen=True)
class Collection:
    """The runs below folders.

    runs: one row per run.
        run, folder: path below the folder, or below the one that holds all folders, and whole path.
        scene, recipe, model, changes (dotted key → value), seed, capture, kind, decided: as the run declares them.
        protocol: the id of what its numbers are measured by. images: rendered by the program, or given.
        gpu: device and engine that rendered it; empty for the CPU.
        scene_label, recipe_label: name and changes of the data, or of all else, for people: `fast (train.batch=4)`.
        method: recipe and all changes. changed: whether anything but the data is. trained, validation: kind, decided.
        final.*, best_on_test.*, and costs: the numbers of metrics.METRICS as metrics.json has them; NaN: not measured.
        best_on_test.iteration, test_split, NOTES, CPU.
        machine, date, git_commit, command.
    curves: one row per evaluation: run, IDENTITY, CURVE_COLUMNS, CURVE_OPTIONAL (NaN: not measured).
    settings: run -> config.yaml, flattened to dotted keys.
    left_out: one line for each run that can't be used. warnings: one line for each file that can't be used.
    """

    runs: pd.DataFrame
    curves: pd.DataFrame
    settings: dict[str, dict[str, Any]]
    left_out: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


def collect(*roots: Path) -> Collection:
    """All runs below `roots`; of repetitions the first. FileNotFoundError if there is none that can be read."""
    for root in roots:
        if not root.is_dir():
            found = "a file" if root.exists() else "nothing"
            raise FileNotFoundError(f"{root}: expected a folder of runs, found {found}; {_HOW_TO_START}")
    base = Path(os.path.commonpath([root.absolute() for root in roots]))
    rows: dict[tuple, dict[str, Any]] = {}
    curves: list[pd.DataFrame] = []
    settings: dict[str, dict[str, Any]] = {}
    left_out: list[str] = []
    warnings: list[str] = []

    def or_warn(reader: Callable[[Path], Any], path: Path, default: Any) -> Any:
        try:
            return reader(path)
        except BrokenRun as error:
            warnings.append(f"{run}: {error}")
            return default

    for folder in dict.fromkeys(folder for root in roots for folder in run_folders(root)):
        run = folder.absolute().relative_to(base).as_posix()
        try:
            row = {"run": run, "folder": folder, **read_metrics(folder / "metrics.json")}
            config = read_settings(folder / "config.yaml")
        except BrokenRun as error:
            left_out.append(f"{run}: left out: {error}")
            continue
        identity = tuple(row[key] for key in IDENTITY)
        if identity in rows:
            left_out.append(f"{run}: left out: same scene, recipe, model, changes and seed as {rows[identity]['run']}")
            continue
        rows[identity] = row | or_warn(
            read_provenance, folder / "environment.json", dict.fromkeys(PROVENANCE, "unknown")
        )
        settings[run] = config
        curve = or_warn(read_curve, folder / "error_vs_time.csv", None) if row["images"] == RENDERED else None
        if curve is not None:
            curves.append(curve.assign(run=run, **dict(zip(IDENTITY, identity))))
    if not rows:
        found = f"none; {_HOW_TO_START}"
        if left_out:
            found = f"{len(left_out)} that cannot be used; the first: {left_out[0]}; {_HOW_TO_RESUME}"
        where = ", ".join(map(str, roots))
        raise FileNotFoundError(f"{where}: expected at least one finished run (metrics.json), found {found}")
    no_curves = pd.DataFrame(columns=[*CURVE_COLUMNS, *CURVE_OPTIONAL, "run", *IDENTITY])
    all_curves = pd.concat(curves, ignore_index=True) if curves else no_curves
    return Collection(pd.DataFrame(list(rows.values())), all_curves, settings, tuple(left_out), tuple(warnings))


def run_folders(runs_dir: Path) -> list[Path]:
    """Folders with a config.yaml or metrics.json, sorted, without hidden folders (Hydra's own)."""
    found = {path.parent for name in ("config.yaml", "metrics.json") for path in runs_dir.rglob(name)}
    return sorted(f for f in found if not any(part.startswith(".") for part in f.relative_to(runs_dir).parts))


def label(name: str, changes: Mapping[str, Any]) -> str:
    """`fast (train.batch=4)`. For people: no program takes it apart."""
    return f"{name} ({_listed(changes)})" if changes else name


def _listed(values: Mapping[str, Any]) -> str:
    return clear(", ".join(f"{key}={_plain(value)}" for key, value in sorted(values.items())), MAX_TEXT)


def _plain(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value)


def metric_columns() -> list[tuple[str, str]]:
    """(column, key) of every metric of a run: costs once, others for both protocols."""
    return list({METRICS[key].column(protocol): key for protocol in (FINAL, BEST) for key in METRICS}.items())


def read_metrics(path: Path) -> dict[str, Any]:
    """metrics.json, checked, as a row of Collection.runs without folder and provenance."""
    if not path.is_file():
        raise BrokenRun("unfinished: no metrics.json")
    # Reports are published: a note may name files in the user's home folder.
    data = read_object(path, lambda text: text.replace(str(Path.home()), "~"))
    row = _declared(data)
    parts = {protocol: _part(data, protocol) for protocol in (FINAL, BEST)}
    for column, key in metric_columns():
        row[column] = _number(parts.get(column.split(".")[0], data).get(key), column)
    row |= {key: _number(_part(data, "cpu").get(key), f"cpu.{key}") for key in CPU}
    row[f"{BEST}.iteration"] = _number(parts[BEST].get("iteration"), f"{BEST}.iteration")
    for key in REQUIRED if row["images"] == RENDERED else QUALITY:
        if math.isnan(row[key]):
            raise BrokenRun(f"metrics.json: {key}: expected a number, found none")
    return row | {"test_split": _text(data.get("test_split"))} | {key: _text(parts[FINAL].get(key)) for key in NOTES}


def _declared(data: Mapping[str, Any]) -> dict[str, Any]:
    """What the run says that it is, and the labels made of it."""
    row: dict[str, Any] = {}
    for key in ("scene", "recipe", "model"):
        row[key] = data.get(key)
        if not isinstance(row[key], str) or not row[key] or clear(row[key]) != row[key]:
            raise BrokenRun(f"metrics.json: {key}: expected a name, found {row[key]!r}")
    row["protocol"] = _text(data.get("protocol")) or UNRECORDED
    row["images"] = data.get("images", RENDERED)
    if row["images"] not in IMAGES:
        raise BrokenRun(f"metrics.json: images: expected {' or '.join(IMAGES)}, found {row['images']!r}")
    by = _part(data, "rendered_by")
    row["gpu"] = "" if by.get("backend", "cpu") == "cpu" else f"{_text(by.get('device'))}, {_text(by.get('engine'))}"
    row["capture"] = data.get("capture")
    if row["capture"] not in get_args(Capture):
        raise BrokenRun(f"metrics.json: capture: expected {', '.join(get_args(Capture))}, found {row['capture']!r}")
    seed = data.get("seed")
    if not isinstance(seed, int) or isinstance(seed, bool) or not 0 <= seed <= MAX_SEED:
        raise BrokenRun(f"metrics.json: seed: expected an integer in 0..{MAX_SEED}, found {seed!r}")
    changes, kind, decided = (
        {_text(name): _text(value) if isinstance(value, str) else value for name, value in _part(data, key).items()}
        for key in ("changes", "kind", "decided")
    )
    of_scene = {key: value for key, value in changes.items() if key.startswith("scene.")}
    others = {key: value for key, value in changes.items() if key not in of_scene}
    return row | {
        "seed": seed,
        "changes": changes,
        "kind": kind,
        "decided": decided,
        "scene_label": label(row["scene"], of_scene),
        "recipe_label": label(row["recipe"], others),
        "method": label(row["recipe"], changes),
        "changed": bool(others),
        "trained": _listed(kind),
        "validation": _listed(decided) or "nothing",
    }


def _part(data: Mapping[str, Any], key: str) -> dict[str, Any]:
    part = data.get(key) or {}
    if not isinstance(part, dict):
        raise BrokenRun(f"metrics.json: {key}: expected an object, found {part!r}")
    return part


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


def read_provenance(path: Path) -> dict[str, str]:
    """environment.json: the PROVENANCE keys as text, `unknown` where missing."""
    if not path.is_file():
        raise BrokenRun(f"no {path.name}: machine and date unknown")
    data = read_object(path)
    return {key: _text(data.get(key)) or "unknown" for key in PROVENANCE}


def read_settings(path: Path) -> dict[str, Any]:
    """config.yaml flattened to dotted keys (`train.densify.every`: 100); empty where the run has none."""
    if not path.is_file():
        return {}
    try:
        return flat(read_config(path, path.name))
    except DataError as error:
        raise BrokenRun(str(error)) from None


def read_view_psnr(path: Path) -> dict[str, float]:
    """per_image.csv: PSNR of the final model by view (`/` as `_`, as in file names); empty if it can't be read."""
    try:
        table = pd.read_csv(path)
    except (OSError, ValueError, OverflowError):
        return {}
    if not {"view", "psnr"} <= set(table):
        return {}
    if "model" in table:
        table = table[table["model"] == FINAL]
    return {
        str(view).replace("/", "_"): float(psnr)
        for view, psnr in zip(table["view"], pd.to_numeric(table["psnr"], errors="coerce"))
        if psnr == psnr
    }


def read_object(path: Path, preprocess: Callable[[str], str] = str) -> dict[str, Any]:
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


def is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) <= MAX_NUMBER


def _number(value: Any, key: str) -> float:
    """A finite float; NaN for None."""
    if value is None:
        return math.nan
    if not is_number(value):
        raise BrokenRun(f"metrics.json: {key}: expected a finite number, found {value!r}")
    return float(value)
