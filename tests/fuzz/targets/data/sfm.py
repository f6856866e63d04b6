"""Target pipeline/data/sfm/cache.py: the cached result of structure from motion."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from hypothesis.strategies import SearchStrategy

from fuzz.edits.arrays import edit_npz
from fuzz.edits.bytes import changed_files
from fuzz.edits.json import edit_json
from fuzz.target import Changes, Files, Target, read_files, require, valid_or_refused
from pipeline.data.sfm.cache import load, save
from pipeline.data.sfm.reconstruction import CalibratedCamera, Reconstruction
from rasterizer import Camera

POINTS = 4


def example() -> Files:
    """Only the files that are read back."""
    cameras = {f"cam{n:02d}": CalibratedCamera(Camera(8, 6, 7.0, 7.0, 4.0, 3.0, np.eye(4)), 0.01 * n) for n in range(2)}
    rng = np.random.default_rng(0)
    found = Reconstruction(
        rng.normal(size=(POINTS, 3)),
        rng.integers(0, 256, (POINTS, 3), dtype=np.uint8),
        np.full(POINTS, 0.5),
        np.full(POINTS, 3),
        cameras,
        "estimated",
        2,
        1.5,
    )
    with tempfile.TemporaryDirectory() as temporary:
        save(found, Path(temporary) / "sfm")
        files = read_files(Path(temporary) / "sfm")
    return {name: content for name, content in files.items() if name.startswith("result.")}


def changes(files: Files) -> SearchStrategy[Changes]:
    return changed_files(files, {".json": edit_json, ".npz": edit_npz})


def check(folder: Path) -> str:
    with valid_or_refused(folder) as outcome:
        found = load(folder)
        count = len(found.points)
        require(
            count > 0 and found.points.shape == (count, 3) and bool(np.isfinite(np.float32(found.points)).all()),
            f"points {found.points.shape}",
        )
        require(found.colors.shape == (count, 3) and found.colors.dtype == np.uint8, f"colours {found.colors.shape}")
        require(found.errors.shape == found.track_lengths.shape == (count,), "errors or tracks of other points")
        require(all(np.isfinite(value) for key, value in found.summary().items() if key != "poses"), "a NaN summary")
        require(
            all(isinstance(c.camera, Camera) and np.isfinite(c.radial) for c in found.cameras.values()),
            "an invalid camera",
        )
    return outcome[0]


TARGET = Target("sfm", "COLMAP's cached result: result.json and result.npz", example, changes, check)
