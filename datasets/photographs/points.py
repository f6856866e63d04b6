"""Points that came with photographs, whatever range their colours have."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from plyfile import PlyData

from datasets.files.errors import SceneError
from datasets.scene import ScenePoints
from datasets.source import Log
from rasterizer.camera import MAX_DISTANCE

GREY = 128  # of 255
NAMES = (("red", "green", "blue"), ("diffuse_red", "diffuse_green", "diffuse_blue"), ("r", "g", "b"))
RANGES = (1.0, 255.0, 65535.0)  # of colours
MOST = 0.99  # of the values lie in the range; others are outliers


def scene_points(positions: np.ndarray, colors: np.ndarray | None, log: Log) -> ScenePoints | None:
    """(N, 3) positions and colours of any type, of 0 to 1, 255 or 65535; grey without.

    What is no place in a scene is left out. None if all are.
    """
    with np.errstate(all="ignore"):
        good = (np.abs(positions) <= MAX_DISTANCE).all(axis=1)  # NaN is no place
    if not good.all():
        log(f"points: {np.count_nonzero(~good)} of {len(good)} are not within {MAX_DISTANCE:g} and left out")
    if not good.any():
        return None
    levels = np.full((np.count_nonzero(good), 3), GREY, np.uint8) if colors is None else _levels(colors[good], log)
    return ScenePoints(positions[good].astype(np.float64), levels)


def _levels(colors: np.ndarray, log: Log) -> np.ndarray:
    """(N, 3) of 0 to 255, uint8."""
    values = colors.astype(np.float64)
    finite = np.append(values[np.isfinite(values)], 0.0)
    low, high = np.quantile(finite, 1 - MOST, method="lower"), np.quantile(finite, MOST, method="higher")
    whole = colors.dtype.kind in "ui"
    limit = next((limit for limit in RANGES[1 if whole else 0 :] if high <= limit), None)
    if low < 0 or limit is None:
        log(f"points: colours of {low:g} to {high:g}, which is none of 0 to 1, 255 and 65535: grey instead")
        return np.full(values.shape, GREY, np.uint8)
    if limit == RANGES[-1]:
        log(f"points: colours of 0 to {high:g} are taken as 16 bits")
    with np.errstate(all="ignore"):
        return np.nan_to_num(np.clip(255 / limit * values, 0, 255), nan=GREY).round().astype(np.uint8)


def read_ply_points(path: Path, log: Log) -> ScenePoints | None:
    """x, y, z and the colours of a .ply; grey without colours, None without points."""
    try:
        vertices = PlyData.read(str(path))["vertex"]
        present = [p.name for p in vertices.properties]
        positions = np.stack([np.asarray(vertices[axis], np.float64) for axis in "xyz"], axis=1)
        names = next((names for names in NAMES if set(names) <= set(present)), ())
        colors = np.stack([np.asarray(vertices[name]) for name in names], axis=1) if names else None
    except Exception as error:  # plyfile and numpy raise many types for broken files
        raise SceneError(path, "a .ply with the vertices x, y, z", str(error)) from None
    if colors is None:
        log(f"{path.name}: no red, green and blue among {', '.join(present)}: grey points")
    return scene_points(positions, colors, log)
