"""The evaluations in the log of a run: PSNR of training and held-out views, lifetimes."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np


@dataclass(frozen=True)
class History:
    """One run; arrays over its E evaluations."""

    label: str
    scene: str
    iteration: np.ndarray  # (E,)
    train_psnr: np.ndarray  # (E,) dB
    psnr: np.ndarray  # (E,) dB, held-out views
    lifetimes: np.ndarray | None  # (E, 5) quantiles lifetimes.QUANTILES, in frames; None: static model
    lifetime_counts: np.ndarray | None  # (E, B) Gaussians in each bin of lifetimes.BIN_EDGES


def read_history(folder: Path) -> History:
    """ValueError, one line, where `folder` holds no finished run whose log has all of it."""
    try:
        metrics = json.loads((folder / "metrics.json").read_text())
        lines = (folder / "log.jsonl").read_text().splitlines()
    except (OSError, json.JSONDecodeError) as error:
        raise ValueError(f"{folder}: expected a finished run, found {error}") from None
    missing = [
        key for key in ("train", "ablation", "seed", "scene") if not isinstance(metrics, dict) or key not in metrics
    ]
    if missing:
        raise ValueError(f"{folder / 'metrics.json'}: expected {', '.join(missing)}, found none")
    rows = [row for row in map(_parsed, lines) if row.get("event") == "evaluate"]
    if not rows or any("train_psnr" not in row or isinstance(row.get("lifetimes", []), list) for row in rows):
        raise ValueError(
            f"{folder / 'log.jsonl'}: expected evaluations with train_psnr, found "
            f"{'none' if not rows else 'a run of an earlier version'}"
        )
    rows = list({row["iteration"]: row for row in rows}.values())  # a resumed run repeats some evaluations
    quantiles = counts = None
    if rows[0]["lifetimes"] is not None:
        quantiles, counts = (np.array([row["lifetimes"][key] for row in rows]) for key in ("quantiles", "counts"))
    column = {name: np.array([row[name] for row in rows]) for name in ("iteration", "train_psnr", "psnr")}
    label = metrics["train"] if metrics["ablation"] == "full" else f"{metrics['train']}, {metrics['ablation']}"
    return History(
        f"{label}, seed {metrics['seed']}", metrics["scene"], **column, lifetimes=quantiles, lifetime_counts=counts
    )


def _parsed(line: str) -> dict:
    """A line of log.jsonl; nothing of one that was cut short by a kill."""
    try:
        row = json.loads(line)
    except json.JSONDecodeError:
        return {}
    return row if isinstance(row, dict) else {}
