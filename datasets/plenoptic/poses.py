"""poses_bounds.npy: LLFF's poses, one row of 17 numbers a camera, in the order of the videos' names.

3 x 5, row by row: columns DOWN, RIGHT, BACKWARDS (the camera's axes in the world), position, (height, width, focal)
near, far: distances between which the scene lies, world units
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from datasets.cameras.transforms import read_pose
from datasets.scene import Box, SceneError, camera_of, cube_round
from rasterizer.camera import FARTHEST, Camera

ROW = 17
# LLFF's normalisation: the nearest bound of all cameras lies at 1 / 0.75 = 1.33 units.
NEAR_TO_UNIT = 0.75


@dataclass(frozen=True)
class Poses:
    """What poses_bounds.npy says of the cameras in use."""

    cameras: dict[str, Camera]  # of the videos as they are, not downscaled
    unit: float  # world units of one normalised unit
    init_box: Box  # holds the cameras, and the far bound in the middle of each one's view


def read_poses(path: Path, names: Sequence[str], keep: Collection[str], size: tuple[int, int]) -> Poses:
    """Checked poses of the cameras `keep`.

    names: of all videos in the folder, by name. size: (width, height) of the videos; poses made for another scale of
    the same image have their focal length scaled.
    """
    table = _load(path)
    if len(table) != len(names):
        raise SceneError(path, f"{len(names)} poses, one a video in the folder", f"{len(table)}")
    cameras, nears, corners = {}, [], []
    for row, (name, values) in enumerate(zip(names, table)):
        if name not in keep:
            continue  # a camera may be dropped because its pose is bad
        where = f"{path}: row {row} ({name})"
        if not np.isfinite(values).all():
            raise SceneError(where, "finite numbers", "NaN or Inf")
        camera = cameras[name] = _camera(values[:15].reshape(3, 5), size, where)
        near, far = values[15:]
        if not 0 < near < far <= FARTHEST:
            raise SceneError(
                where, f"bounds 0 < near < far, which is {FARTHEST:g} at most", f"near {near:g}, far {far:g}"
            )
        nears.append(near)
        corners += [camera.position, camera.position + far * camera.world_to_cam[2, :3]]
    return Poses(cameras, NEAR_TO_UNIT * float(min(nears)), cube_round(corners))


def _load(path: Path) -> np.ndarray:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # that Python 2 wrote the file
            # Mapped: a header may promise more than the memory holds.
            table = np.load(path, mmap_mode="r", allow_pickle=False)
    except FileNotFoundError:
        raise SceneError(path, "a file (without poses the videos are for scene=video)", "none") from None
    except Exception as error:  # numpy raises many types for broken files
        raise SceneError(path, "a numpy array", str(error)) from None
    if not isinstance(table, np.ndarray) or table.ndim != 2 or table.shape[1] != ROW or table.dtype.kind not in "fiu":
        found = f"{table.dtype} {table.shape}" if isinstance(table, np.ndarray) else "an archive"
        raise SceneError(path, f"numbers, one row of {ROW} a camera", found)
    with np.errstate(over="ignore"):  # wider floats than these become infinite, and are refused as such
        return np.array(table, dtype=np.float64)


def _camera(block: np.ndarray, size: tuple[int, int], where: str) -> Camera:
    """block: (3, 5), see above."""
    down, right, backwards, position, sizes = block.T
    height, width, focal = (float(value) for value in sizes)
    cam_to_world = np.eye(4)
    cam_to_world[:3] = np.stack([right, down, -backwards, position], axis=1)  # COLMAP's x, y, z
    cam_to_world = read_pose(cam_to_world, where)
    if not (focal > 0 and height > 0 and width > 0):
        raise SceneError(where, "height, width and focal length > 0", f"{height:g}, {width:g}, {focal:g}")
    scale_x, scale_y = size[0] / width, size[1] / height
    # Another scale of the same image: the sides, each rounded to whole pixels, fit one factor.
    if not abs(width * scale_y - size[0]) <= max(1.0, scale_y) < math.inf:
        raise SceneError(
            where,
            "the videos' {} x {} pixels or the same shape at another scale".format(*size),
            f"{width:g} x {height:g}",
        )
    return camera_of(
        where,
        lambda: Camera(*size, focal * scale_x, focal * scale_y, size[0] / 2, size[1] / 2, np.linalg.inv(cam_to_world)),
    )
