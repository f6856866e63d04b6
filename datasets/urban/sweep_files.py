"""LiDAR sweeps: flat files of little-endian float32, one row a point."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from datasets.files.errors import SceneError

FARTHEST = 1e4  # metres: no LiDAR reaches as far


def read_floats(path: Path) -> np.ndarray:
    """All of the file's values, (n,) float32; SceneError for a size that is no multiple of four bytes."""
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        raise SceneError(path, "a LiDAR sweep", "no such file") from None
    except OSError as error:
        raise SceneError(path, "a LiDAR sweep", str(error)) from None
    if len(content) % 4:
        raise SceneError(path, "float32 values, four bytes each", f"{len(content)} bytes: the file is cut short")
    return np.frombuffer(content, dtype="<f4")


def read_points(path: Path, columns: int) -> np.ndarray:
    """(N, columns) float32; SceneError for another number of columns, for no points, and for points beyond reach."""
    values = read_floats(path)
    if values.size == 0 or values.size % columns:
        raise SceneError(path, f"rows of {columns} float32 values", f"{values.size} values: the file is cut short")
    return values.reshape(-1, columns)


def check_reach(points: np.ndarray, path: Path) -> None:
    """SceneError for points (N, 3) that are not finite or beyond FARTHEST, in the sensor's or the car's frame."""
    if not np.isfinite(points).all():
        raise SceneError(path, "finite points", "NaN or Inf")
    if (largest := float(np.abs(points).max(initial=0.0))) > FARTHEST:
        raise SceneError(path, f"points within {FARTHEST:g} m of the car", f"{largest:g} m")


def transformed(points: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """(N, 3) points through a (4, 4) rigid matrix, float64."""
    return points.astype(np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
