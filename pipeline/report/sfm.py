"""The section on structure from motion: COLMAP's points, camera poses and reprojection errors per scene.

A run that was initialised by structure from motion has sfm.json and sfm.png. Runs of a scene share COLMAP's result, so
the table has one row per scene, or one per result where results differ.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pandas as pd

from datasets.files.errors import clear
from pipeline.presentation.table import Cell, Column, Row, Table, number
from pipeline.report import scenes
from pipeline.report.runs import BrokenRun, is_number, read_object
from pipeline.report.strips import RunFigure, compose, opened, webp_name

SFM_NUMBERS = {  # key of sfm.json -> (header, decimals)
    "cameras": ("Cameras", 0),
    "registered": ("Registered", 0),
    "points": ("Points", 0),
    "mean_error_px": ("Mean reprojection error ↓, px", 3),
    "mean_track_length": ("Mean track length, images", 2),
    "seconds": ("Seconds", 1),
}
SFM_POSES = ("known", "refined", "estimated")
_MAX_SIDE = 1024  # pixels
_NOTE = (
    "",
    "Poses: known (given by the data), refined (adjusted by COLMAP) or estimated (by COLMAP alone). Seconds: of the "
    "run that computed the result; the other runs read it from the cache.",
)


def sfm_section(
    runs: pd.DataFrame, no_pictures: tuple[str, ...] = ()
) -> tuple[Table | None, list[RunFigure], list[str]]:
    """The table (None without any sfm.json), pictures, and a warning for each file that can't be read."""
    rows, pictures, warnings = [], [], []
    for scene in scenes.in_order(runs["scene"]):
        groups, unread = _distinct_results(runs[runs["scene"] == scene])
        warnings += unread
        for i, group in enumerate(groups):
            folder, result = group[0]
            rows.append(_row(scene, result, len(group)))
            if scenes.is_excluded(scene, no_pictures):
                continue
            try:
                webp = compose([opened(folder / "sfm.png")], _MAX_SIDE)
            except Exception as error:  # PIL raises many types for damaged files
                warnings.append(f"{scene}: no picture of points and cameras: {clear(error)}")
                continue
            name = webp_name(scene, f"sfm_{i + 1}" if i else "sfm")
            pictures.append(RunFigure(scene, "", "points and cameras", "", name, webp))
    return (_table(rows) if rows else None), pictures, warnings


def _distinct_results(runs: pd.DataFrame) -> tuple[list[list[tuple[Path, dict[str, Any]]]], list[str]]:
    """(folder, result) of one scene's runs, grouped by result; and a warning for each file that can't be read."""
    groups: dict[str, list[tuple[Path, dict[str, Any]]]] = {}
    warnings = []
    for run in runs.to_dict("records"):
        folder = Path(run["folder"])
        if not (folder / "sfm.json").is_file():
            continue  # initialised with random points
        try:
            result = read_sfm(folder / "sfm.json")
        except BrokenRun as error:
            warnings.append(f"{run['run']}: {error}")
            continue
        key = json.dumps({name: value for name, value in result.items() if name != "seconds"}, sort_keys=True)
        groups.setdefault(key, []).append((folder, result))
    return list(groups.values()), warnings


def read_sfm(path: Path) -> dict[str, Any]:
    """sfm.json: SFM_NUMBERS as finite numbers and `poses`, one of SFM_POSES."""
    data = read_object(path)
    for key in SFM_NUMBERS:
        if not is_number(data.get(key)):
            raise BrokenRun(f"{path.name}: {key}: expected a finite number, found {data.get(key)!r}")
    if data.get("poses") not in SFM_POSES:
        raise BrokenRun(f"{path.name}: poses: expected {', '.join(SFM_POSES)}, found {data.get('poses')!r}")
    return {key: data[key] for key in (*SFM_NUMBERS, "poses")}


def _row(scene: str, result: dict[str, Any], runs: int) -> Row:
    cells = {key: number(result[key], decimals) for key, (_, decimals) in SFM_NUMBERS.items()}
    return Row({"scene": Cell(scene), "poses": Cell(result["poses"]), "runs": number(runs, 0)} | cells)


def _table(rows: list[Row]) -> Table:
    numbers = (Column(key, header) for key, (header, _) in SFM_NUMBERS.items())
    columns = (Column("scene", "Scene", False), Column("poses", "Poses", False), *numbers, Column("runs", "Runs"))
    title = "Points and camera poses from COLMAP"
    return Table("structure", title, columns, tuple(rows), notes=(_NOTE,), over_seeds=False, section="sfm")
