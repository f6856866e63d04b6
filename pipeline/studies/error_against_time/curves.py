"""Learning curves of runs, and their mean over scenes at equal CPU seconds."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from datasets.files.errors import DataError
from pipeline.runs.run_identity import read_config


@dataclass(frozen=True)
class Curve:
    """The evaluations of a run on held-out views."""

    commit: str
    kernel: str  # with its instruction set: kernel_v4
    recipe: str
    scene: str
    seed: int
    finished: bool  # a stopped run says nothing about later times
    iterations: np.ndarray  # (n,)
    seconds: np.ndarray  # (n,) CPU seconds of training, ascending
    psnr: np.ndarray  # (n,) dB, mean of the views
    gaussians: np.ndarray  # (n,)


def read_curves(folder: Path) -> list[Curve]:
    """Of all runs below `folder` that were evaluated at least once. DataError for one whose files can't be read."""
    found = [_curve(path.parent) for path in sorted(folder.rglob("error_vs_time.csv"))]
    if not found:
        raise DataError(folder, "folders of runs", "none")
    return found


def _curve(run: Path) -> Curve:
    config = read_config(run / "config.yaml")
    try:
        made = json.loads((run / "environment.json").read_text(encoding="utf-8"))
        with (run / "error_vs_time.csv").open(encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))
        columns = [
            np.array([float(row[name]) for row in rows]) for name in ("iteration", "cpu_seconds", "psnr", "n_gaussians")
        ]
        kernel, commit = made["rendered_by"]["engine"], made["git_commit"][:8]
        recipe, scene, seed = config["train"]["name"], config["scene"]["name"], config["seed"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise DataError(run, "config.yaml, environment.json and error_vs_time.csv of a run", str(error)) from None
    return Curve(commit, kernel, recipe, scene, seed, (run / "metrics.json").is_file(), *columns)


def by_recipe(curves: Sequence[Curve], folder: Path) -> dict[str, list[Curve]]:
    """Label of recipe and kernel -> its runs. DataError where recipes were not run on the same scenes as often."""
    groups: dict[str, list[Curve]] = {}
    for curve in sorted(curves, key=lambda curve: (curve.recipe, curve.kernel)):
        groups.setdefault(f"{curve.recipe}, {curve.kernel}", []).append(curve)
    scenes = {name: sorted(curve.scene for curve in group) for name, group in groups.items()}
    first = next(iter(scenes))
    for name, own in scenes.items():
        if own != scenes[first]:
            raise DataError(folder, f"the scenes of {first} for {name}: {', '.join(scenes[first])}", ", ".join(own))
    return groups


def mean_curve(curves: Sequence[Curve]) -> tuple[np.ndarray, np.ndarray]:
    """(CPU seconds, mean PSNR), from where all runs have a value to where the first one was stopped.

    A finished run keeps its last value. Between evaluations PSNR is linear in time.
    """
    start = max(curve.seconds[0] for curve in curves)
    end = min((curve.seconds[-1] for curve in curves if not curve.finished), default=np.inf)
    times = np.unique(np.concatenate([[start], *(curve.seconds for curve in curves)]))
    times = times[(times >= start) & (times <= end)]
    return times, np.mean([np.interp(times, curve.seconds, curve.psnr) for curve in curves], axis=0)


def value_at(times: np.ndarray, values: np.ndarray, at: float, last: bool) -> float | None:
    """The value at a time; None before the first time, and behind the last one unless that is the `last` value."""
    if not len(times) or at < times[0] or (at > times[-1] and not last):
        return None
    return float(np.interp(at, times, values))
