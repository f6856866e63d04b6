"""Learning curves of runs, finished or stopped, and their means over scenes (pipeline/report/mean_curves.py)."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from datasets.files.errors import DataError
from pipeline.report.mean_curves import mean_curve
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
    evaluations: pd.DataFrame  # iteration, cpu_seconds (ascending), psnr in dB, n_gaussians

    @property
    def end(self) -> float:
        """CPU seconds at the last evaluation."""
        return float(self.evaluations["cpu_seconds"].iloc[-1])


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
        columns = ["iteration", "cpu_seconds", "psnr", "n_gaussians"]
        evaluations = pd.read_csv(run / "error_vs_time.csv")[columns].astype(float)
        kernel, commit = made["rendered_by"]["engine"], made["git_commit"][:8]
        recipe, scene, seed = config["train"]["name"], config["scene"]["name"], config["seed"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise DataError(run, "config.yaml, environment.json and error_vs_time.csv of a run", str(error)) from None
    return Curve(commit, kernel, recipe, scene, seed, (run / "metrics.json").is_file(), evaluations)


def by_recipe(curves: list[Curve], folder: Path) -> dict[str, list[Curve]]:
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


def mean_until_stopped(curves: list[Curve]) -> tuple[np.ndarray, np.ndarray]:
    """(CPU seconds, mean PSNR), from where all runs have a value to where the first one was stopped."""
    runs = pd.DataFrame({"run": range(len(curves)), "threads": 1.0})
    all_evaluations = pd.concat([curve.evaluations.assign(run=run) for run, curve in enumerate(curves)])
    mean = mean_curve(runs, all_evaluations.assign(train_seconds=np.nan))  # all have CPU seconds
    mean = mean[mean["cpu_seconds"] <= min((curve.end for curve in curves if not curve.finished), default=np.inf)]
    return mean["cpu_seconds"].to_numpy(), mean["psnr"].to_numpy()


def value_at(times: np.ndarray, values: np.ndarray, at: float, last: bool) -> float | None:
    """The value at a time; None before the first time, and behind the last one unless that is the `last` value."""
    if not len(times) or at < times[0] or (at > times[-1] and not last):
        return None
    return float(np.interp(at, times, values))
