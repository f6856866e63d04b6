"""What a run's log says of it as training went on."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np


@dataclass(frozen=True)
class History:
    """One run; arrays over its evaluations."""

    label: str
    scene: str
    iteration: np.ndarray  # (E,)
    train_psnr: np.ndarray  # (E,) dB
    psnr: np.ndarray  # (E,) dB, held-out views
    lifetimes: np.ndarray | None  # (E, 5) lifetimes.QUANTILES, in frames; None: static
    lifetime_counts: np.ndarray | None  # (E, B) Gaussians in lifetimes.BIN_EDGES


def read_history(folder: Path) -> History:
    """Raises ValueError, one line, where the folder holds no finished run that logged all this."""
    try:
        about = json.loads((folder / "metrics.json").read_text())
        lines = (folder / "log.jsonl").read_text().splitlines()
    except (OSError, json.JSONDecodeError) as error:
        raise ValueError(f"{folder}: expected a finished run, found {error}") from None
    rows = [row for row in map(json.loads, lines) if row.get("event") == "evaluate"]
    if not rows or any("train_psnr" not in row or isinstance(row["lifetimes"], list) for row in rows):
        raise ValueError(
            f"{folder / 'log.jsonl'}: expected evaluations with train_psnr, found "
            f"{'none' if not rows else 'a run of an earlier version'}"
        )
    rows = list({row["iteration"]: row for row in rows}.values())  # a resumed run evaluates some of them again
    lived = counts = None
    if rows[0]["lifetimes"] is not None:
        lived, counts = (np.array([row["lifetimes"][key] for row in rows]) for key in ("quantiles", "counts"))
    column = {name: np.array([row[name] for row in rows]) for name in ("iteration", "train_psnr", "psnr")}
    label = about["train"] if about["ablation"] == "full" else f"{about['train']}, {about['ablation']}"
    return History(label, about["scene"], **column, lifetimes=lived, lifetime_counts=counts)
