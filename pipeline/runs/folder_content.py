"""A run folder as one object, which schemas/run_folder.schema.json describes; metrics.schema.json is metrics.json's."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

from pipeline.runs.run_identity import read_config

SCHEMAS = Path(__file__).with_name("schemas")


def schema(name: str) -> dict[str, Any]:
    """`metrics`, or `run_folder` with that of metrics.json in it."""
    found = json.loads((SCHEMAS / f"{name}.schema.json").read_text(encoding="utf-8"))
    return (
        found
        if name == "metrics"
        else found | {"properties": found["properties"] | {"metrics.json": schema("metrics")}}
    )


def folder_content(folder: Path) -> dict[str, Any]:
    """Name of each file -> what is in it: trees, rows of tables with numbers as numbers and empty cells as None; None
    for every other file and folder. Raises what their readers raise."""
    return {path.name: _content(path) for path in sorted(folder.iterdir())}


def _content(path: Path) -> Any:
    if path.suffix == ".json":
        return json.loads(path.read_text(encoding="utf-8"))
    if path.suffix == ".jsonl":
        return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    if path.suffix == ".yaml":
        return read_config(path)
    if path.suffix == ".csv":
        with open(path, newline="", encoding="utf-8") as file:
            return [{name: _value(cell) for name, cell in row.items()} for row in csv.DictReader(file)]
    return None


def _value(cell: str) -> float | str | None:
    try:
        return float(cell) if cell else None
    except ValueError:
        return cell
