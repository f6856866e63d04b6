"""Files of numbers, every error names the file: text (matrices, calibrations, poses), and LiDAR sweeps of float32."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from datasets.cameras.transforms import read_pose
from datasets.files.errors import SceneError
from datasets.urban.log import SweepPoints
from datasets.urban.sweep_columns import FEWEST_VALUES, row_length

LONGEST_FILE = 64 * 2**20  # bytes: the poses of a log of a million frames
FARTHEST = 1e4  # metres: no LiDAR reaches as far


def read_lines(path: Path) -> list[str]:
    """The lines that are not empty."""
    try:
        if path.stat().st_size > LONGEST_FILE:
            raise SceneError(path, f"at most {LONGEST_FILE} bytes of text", f"{path.stat().st_size} bytes")
        lines = [line.strip() for line in path.read_text(encoding="utf-8").splitlines()]
    except FileNotFoundError:
        raise SceneError(path, "a file", "none") from None
    except (UnicodeDecodeError, OSError) as error:
        raise SceneError(path, "a text file", str(error)) from None
    return [line for line in lines if line]


def numbers(words: list[str], where: str | Path) -> np.ndarray:
    """The words as float64; SceneError for what is no number, NaN and Inf."""
    try:
        found = np.array([float(word) for word in words])
    except ValueError as error:
        raise SceneError(where, "numbers", str(error)) from None
    if not np.isfinite(found).all():
        raise SceneError(where, "finite numbers", "NaN or Inf")
    return found


def read_rows(path: Path, columns: int) -> np.ndarray:
    """(rows, columns) float64, one row a line."""
    lines = read_lines(path)
    if not lines:
        raise SceneError(path, f"rows of {columns} numbers", "none")
    rows = []
    for index, line in enumerate(lines):
        words = line.split()
        if len(words) != columns:
            raise SceneError(f"{path}: line {index + 1}", f"{columns} numbers", f"{len(words)}")
        rows.append(numbers(words, f"{path}: line {index + 1}"))
    return np.stack(rows)


def read_matrix(path: Path) -> np.ndarray:
    """A rigid 4 × 4 matrix (np.savetxt)."""
    words = [word for line in read_lines(path) for word in line.split()]
    found = numbers(words, path)
    if found.size != 16:
        raise SceneError(path, "16 numbers, a 4 x 4 matrix", f"{found.size}")
    return read_pose(found.reshape(4, 4), str(path))


def read_calibration(path: Path) -> dict[str, np.ndarray]:
    """Lines `name: numbers` or `name numbers`, by name. Lines whose values are no numbers (a date) are left out."""
    found = {}
    for line in read_lines(path):
        name, *words = line.replace(":", " ", 1).split()
        try:
            found[name] = np.array([float(word) for word in words])
        except ValueError:
            continue
    return found


def entry(values: Mapping[str, np.ndarray], names: tuple[str, ...], shape: tuple[int, ...], where: Path) -> np.ndarray:
    """The entry under one of `names`, of `shape`, finite."""
    for name in names:
        if name in values:
            found = values[name]
            if found.size != int(np.prod(shape)):
                raise SceneError(f"{where}: {name}", f"{int(np.prod(shape))} numbers", f"{found.size}")
            if not np.isfinite(found).all():
                raise SceneError(f"{where}: {name}", "finite numbers", "NaN or Inf")
            return found.reshape(shape)
    raise SceneError(f"{where}: {names[0]}", f"{int(np.prod(shape))} numbers", "no such entry")


def rigid(matrix: np.ndarray, where: str) -> np.ndarray:
    """(4, 4) from a rotation (3, 3), or with a translation (3, 4), checked."""
    pose = np.eye(4)
    pose[:3, : matrix.shape[1]] = matrix
    return read_pose(pose, where)


def rigid_entry(values: Mapping[str, np.ndarray], names: tuple[str, ...], columns: int, where: Path) -> np.ndarray:
    """`rigid` of the entry (3, columns) under one of `names`."""
    return rigid(entry(values, names, (3, columns), where), f"{where}: {names[0]}")


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


def read_sweep(
    path: Path, to_world: np.ndarray, *, columns: int, start: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> SweepPoints:
    """The sweep of a file with rows of x, y, z and more, as many as the layout has unless the values refute it.

    start: of the beams, in the same frame. SceneError for columns that do not stand out, no points or far ones.
    """
    values = read_floats(path)
    found = row_length(_with_others(path, values), columns, path)
    if values.size == 0 or values.size % found:
        raise SceneError(path, f"rows of {found} float32 values", f"{values.size} values: the file is cut short")
    points = values.reshape(-1, found)[:, :3]
    check_reach(points, path)
    note = "" if found == columns else f"rows of {found} values, as theirs show, not {columns} as the layout has"
    return SweepPoints(transformed(points, to_world), transformed(np.array([start]), to_world)[0], note)


def _with_others(path: Path, values: np.ndarray) -> np.ndarray:
    """The values of a short sweep and of as many others of its folder, of the same columns, as tell them apart."""
    others = (other for other in sorted(path.parent.glob(f"*{path.suffix}")) if other != path)
    while values.size < FEWEST_VALUES and (other := next(others, None)):
        values = np.concatenate([values, read_floats(other)])
    return values


def check_reach(points: np.ndarray, path: Path) -> None:
    """SceneError for points (N, 3) that are not finite or beyond FARTHEST, in the sensor's or the car's frame."""
    if not np.isfinite(points).all():
        raise SceneError(path, "finite points", "NaN or Inf")
    if (largest := float(np.abs(points).max(initial=0.0))) > FARTHEST:
        raise SceneError(path, f"points within {FARTHEST:g} m of the car", f"{largest:g} m")


def transformed(points: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """(N, 3) points through a (4, 4) rigid matrix, float64."""
    return points.astype(np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
