"""Reads the paper's tables, exactly as printed, from results/paper/*.csv."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

PAPER_DIR = Path(__file__).resolve().parents[3] / "results" / "paper"


def read(name: str, folder: Path = PAPER_DIR) -> list[dict[str, str]]:
    """Rows of `name`.csv as strings (32.00 stays 32.00); FileNotFoundError if there is no such file."""
    path = folder / f"{name}.csv"
    if not path.is_file():
        raise FileNotFoundError(f"{path}: expected the paper's numbers, found nothing")
    return pd.read_csv(path, dtype=str, keep_default_na=False).to_dict("records")


def footnotes(marks: str, folder: Path = PAPER_DIR) -> tuple[tuple[str, str], ...]:
    """(mark, text) for each of `marks`, in the file's order."""
    return tuple((row["mark"], row["text"]) for row in read("footnotes", folder) if row["mark"] in marks)
