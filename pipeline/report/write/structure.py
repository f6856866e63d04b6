"""What COLMAP found of each scene: how many points, how well they fit, and a picture of them with the cameras.

A run that started from structure from motion leaves sfm.json and sfm.png. Runs of a scene share COLMAP's result, so
the table has a row a scene; where results differ, one for each.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from datasets.files.errors import clear
from pipeline.presentation.table import Column, Row, Table, number, text
from pipeline.report.read import scenes
from pipeline.report.write.strips import compose, kept_back, webp_name
from pipeline.runs.read.collect import LARGEST_NUMBER

_NUMBERS = ("points", "mean_error_px", "mean_track_length", "cameras", "registered", "seconds")
_POSES = ("known", "refined", "estimated")
_MAX_SIDE = 1024  # pixels; one picture stands where a strip has three
_NOTE = (
    "",
    "Poses: known (as the data gives them), refined (adjusted by COLMAP) or estimated (by COLMAP alone). Seconds are "
    "those of the run that computed it; the others found the result in the cache.",
)


@dataclass(frozen=True)
class StructurePicture:
    """Points and cameras of one scene; `webp` is the image."""

    scene: str
    filename: str
    webp: bytes


@dataclass(frozen=True)
class Structure:
    """The report's section."""

    table: Table
    pictures: tuple[StructurePicture, ...]


def structure_from_motion(runs: pd.DataFrame, no_pictures: tuple[str, ...] = ()) -> tuple[Structure | None, list[str]]:
    """The section (None without any sfm.json), and a warning line for each file that can't be read."""
    rows, pictures, warnings = [], [], []
    for scene in scenes.in_order(runs["scene"]):
        found: dict[str, list[tuple[Path, dict[str, Any]]]] = {}  # runs with one result together
        for row in runs[runs["scene"] == scene].to_dict("records"):
            folder = Path(row["folder"])
            if not (folder / "sfm.json").is_file():
                continue  # random points, or a layout with one camera
            try:
                result = read_sfm(folder / "sfm.json")
            except ValueError as error:
                warnings.append(f"{row['run']}: {error}")
                continue
            # How long it took is no part of the result.
            same = json.dumps({key: value for key, value in result.items() if key != "seconds"}, sort_keys=True)
            found.setdefault(same, []).append((folder, result))
        for i, group in enumerate(found.values()):
            folder, result = group[0]
            rows.append(_row(scene, result, len(group)))
            if kept_back(scene, no_pictures):
                continue
            try:
                webp = compose([folder / "sfm.png"], _MAX_SIDE)
            except Exception as error:  # PIL raises many types for broken files
                warnings.append(f"{scene}: no picture of points and cameras: {clear(error)}")
                continue
            pictures.append(StructurePicture(scene, webp_name(scene, f"sfm_{i + 1}" if i else "sfm"), webp))
    return (Structure(_table(rows), tuple(pictures)) if rows else None), warnings


def read_sfm(path: Path) -> dict[str, Any]:
    """sfm.json, checked: _NUMBERS as finite floats, `poses` as one of _POSES. ValueError says what is wrong."""
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError, OSError) as error:  # no text, no JSON, a number of 5,000 digits; too deep
        raise ValueError(f"{path.name}: expected JSON, found {clear(error)}") from None
    if not isinstance(data, dict):
        raise ValueError(f"{path.name}: expected an object, found {type(data).__name__}")
    for key in _NUMBERS:
        value = data.get(key)
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) <= LARGEST_NUMBER:
            raise ValueError(f"{path.name}: {key}: expected a finite number, found {clear(repr(value))}")
    if data.get("poses") not in _POSES:
        raise ValueError(f"{path.name}: poses: expected {', '.join(_POSES)}, found {clear(repr(data.get('poses')))}")
    return {key: data[key] for key in (*_NUMBERS, "poses")}


def _row(scene: str, result: dict[str, Any], runs: int) -> Row:
    decimals = {"points": 0, "mean_error_px": 3, "mean_track_length": 2, "cameras": 0, "registered": 0, "seconds": 1}
    cells = {key: number(result[key], places) for key, places in decimals.items()}
    return Row({"scene": text(scene), "poses": text(result["poses"]), "runs": number(runs, 0)} | cells)


def _table(rows: list[Row]) -> Table:
    columns = (
        Column("scene", "Scene", False),
        Column("poses", "Poses", False),
        Column("cameras", "Cameras"),
        Column("registered", "registered"),
        Column("points", "Points"),
        Column("mean_error_px", "Mean reprojection error ↓, px"),
        Column("mean_track_length", "Mean track length, images"),
        Column("seconds", "Seconds"),
        Column("runs", "Runs"),
    )
    return Table("structure", "Points and poses by COLMAP", columns, tuple(rows), notes=(_NOTE,), over_seeds=False)
