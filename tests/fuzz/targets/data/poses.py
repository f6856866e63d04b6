"""Target datasets/plenoptic/poses.py: poses_bounds.npy alone, which is faster than with videos."""

from __future__ import annotations

import io
import math
from pathlib import Path

import numpy as np
from hypothesis.strategies import SearchStrategy

from datasets.plenoptic.poses import read_poses
from fuzz.edits.arrays import edit_npy
from fuzz.edits.bytes import changed_files
from fuzz.target import Changes, Files, Target, require, valid_or_refused

NAMES = ("cam00", "cam01", "cam02")
SIZE = (32, 24)
FILE = "poses_bounds.npy"


def poses_file() -> bytes:
    """Camera n is at (n, 0, -4) with viewing direction +z."""
    rows = []
    for x in range(len(NAMES)):
        columns = [[0, 1, 0], [1, 0, 0], [0, 0, -1], [x, 0, -4], [SIZE[1], SIZE[0], 30.0]]  # down, right, back, …
        rows.append([*np.array(columns, dtype=float).T.ravel(), 2.0, 10.0])
    file = io.BytesIO()
    np.save(file, np.array(rows))
    return file.getvalue()


def example() -> Files:
    return {FILE: poses_file()}


def changes(files: Files) -> SearchStrategy[Changes]:
    return changed_files(files, {".npy": edit_npy})


def check(folder: Path) -> str:
    with valid_or_refused(folder) as outcome:
        found = read_poses(folder / FILE, NAMES, NAMES, SIZE)
        require(list(found.cameras) == list(NAMES), f"cameras {list(found.cameras)}")
        require(all((camera.width, camera.height) == SIZE for camera in found.cameras.values()), "another size")
        low, high = found.init_box
        require(
            bool(np.isfinite([low, high]).all() and np.less(low, high).all()) and 0 < found.unit < math.inf,
            f"box {low}, {high}, {found.unit}",
        )
    return outcome[0]


TARGET = Target("poses", "poses_bounds.npy", example, changes, check)
