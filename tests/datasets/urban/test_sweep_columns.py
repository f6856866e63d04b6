"""The number of values in a row of a sweep, from simulated beams on the ground and on walls."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from kitti_folder import FRAMES, VELO_TO_CAM, cam0_to_world, sweep, write_odometry

from datasets.files.errors import SceneError
from datasets.readers.kitti import open_kitti
from datasets.settings import SceneConfig
from datasets.urban.assemble import scene_of_log
from datasets.urban.number_files import read_sweep
from datasets.urban.sweep_columns import row_length

HERE = Path("x.bin")


def beams(columns: int, rows: int = 2000, reflectance: float = 1.0) -> np.ndarray:
    """(rows, columns) float32 of a sensor 1.73 m above the ground: x, y, z, reflectance, ring, elongation, time, …"""
    rng = np.random.default_rng(columns)
    azimuth, ring = rng.uniform(-np.pi, np.pi, rows), rng.integers(0, 64, rows)
    down = np.radians(np.linspace(-2, 25, 64))[ring]
    reach = np.minimum(rng.lognormal(2.5, 0.7, rows), 1.73 / np.maximum(np.sin(down), 0.02))
    x, y = reach * np.cos(down) * np.cos(azimuth), reach * np.cos(down) * np.sin(azimuth)
    all_columns = [x, y, -reach * np.sin(down), reflectance * rng.beta(1, 3, rows), ring.astype(float)]
    all_columns += [rng.uniform(0, 0.1, rows), np.linspace(0, 0.1, rows), np.zeros(rows)]
    return np.stack(all_columns[:columns], axis=1).astype(np.float32)


@pytest.mark.parametrize("usual", [4, 6])
@pytest.mark.parametrize("reflectance", [1.0, 255.0])
@pytest.mark.parametrize("columns", range(3, 9))
def test_the_values_tell_the_columns(columns: int, reflectance: float, usual: int) -> None:
    assert row_length(beams(columns, reflectance=reflectance).ravel(), usual, HERE) == columns


def test_points_on_a_plane_and_columns_of_zeros() -> None:
    flat = beams(4)
    flat[:, 2] = -1.3
    assert row_length(flat[:, :3].ravel(), 4, HERE) == 3
    flat[:, 3] = 0
    assert row_length(flat.ravel(), 4, HERE) == 4


def test_values_without_columns_are_refused() -> None:
    noise = np.random.default_rng(0).normal(size=4000).astype(np.float32)
    with pytest.raises(SceneError, match=r"x\.bin: expected columns of one quantity each, 4 values a row, found none"):
        row_length(noise, 4, HERE)


@pytest.mark.parametrize("columns", [3, 5])
def test_a_log_whose_sweeps_have_other_columns(tmp_path: Path, columns: int) -> None:
    """All points are the file's, and the log says what was taken."""
    folder = write_odometry(tmp_path)
    written = {}
    for frame in range(FRAMES):
        rows = np.concatenate([sweep(frame, 300), np.full((300, 1), 7, "<f4")], axis=1)[:, :columns]
        (folder / f"velodyne/{frame:06d}.bin").write_bytes(np.ascontiguousarray(rows).tobytes())
        written[frame] = rows[:, :3]
    log, lines = open_kitti(folder), []
    scene_of_log(log, SceneConfig(name="x", downscale=1, test_every=3), lines.append)
    assert f"5 of 5 LiDAR sweeps: rows of {columns} values, as theirs show, not 4 as the layout has" in lines
    for one in log.sweeps:
        expected = cam0_to_world(one.frame) @ VELO_TO_CAM
        np.testing.assert_allclose(
            one.read().points, written[one.frame].astype(float) @ expected[:3, :3].T + expected[:3, 3], atol=1e-4
        )  # six decimals in the files of poses and calibration


@pytest.mark.parametrize("columns", [3, 4, 5, 6])
def test_short_sweeps_are_judged_together(tmp_path: Path, columns: int) -> None:
    """60 points each, a multiple of 4 in any number of columns: 40 sweeps tell what one does not."""
    rows = beams(columns, 2400).reshape(40, 60, columns)
    for i, values in enumerate(rows):
        values.tofile(tmp_path / f"{i:06d}.bin")
    for i in (0, 20):
        found = read_sweep(tmp_path / f"{i:06d}.bin", np.eye(4), columns=4)
        assert np.array_equal(found.points, rows[i, :, :3])
