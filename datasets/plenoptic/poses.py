"""Reads poses_bounds.npy: LLFF's poses, one row of 17 numbers per camera, in the order of the videos' names.

[0:15]   a 3 × 5 matrix, row by row; its columns are the camera's down, right and backward axes in the world, its
         position, and (height, width, focal length in pixels)
[15:17]  near and far: depth bounds of the scene, world units
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from datasets.cameras.transforms import read_pose
from datasets.files.errors import SceneError
from datasets.scene import Box, bounding_cube, make_camera
from rasterizer.camera import MAX_DISTANCE, Camera

ROW = 17
# LLFF's normalisation: the smallest near bound of all cameras is 1 / 0.75 = 1.33 normalised units.
NEAR_TO_UNIT = 0.75


@dataclass(frozen=True)
class Poses:
    """The content of poses_bounds.npy for the cameras in use."""

    cameras: dict[str, Camera]  # by name; of the full-size frames
    unit: float  # world units per normalised unit
    init_box: Box  # holds the cameras and the points at their far bounds on the optical axes


def read_poses(path: Path, names: Sequence[str], keep: Collection[str], size: tuple[int, int]) -> Poses:
    """The poses of the cameras `keep`; SceneError if they are invalid.

    names: of all videos in the folder, sorted. size: (width, height) of the videos. Focal lengths are scaled if the
    file was made for the same images at another scale.
    """
    table = _load(path)
    if len(table) != len(names):
        raise SceneError(path, f"{len(names)} poses, one a video in the folder", f"{len(table)}")
    cameras, nears, corners = {}, [], []
    for row, (name, values) in enumerate(zip(names, table)):
        if name not in keep:
            continue  # a dropped camera may have an invalid pose
        where = f"{path}: row {row} ({name})"
        if not np.isfinite(values).all():
            raise SceneError(where, "finite numbers", "NaN or Inf")
        camera = cameras[name] = _camera(values[:15].reshape(3, 5), size, where)
        near, far = values[15:]
        if not 0 < near < far <= MAX_DISTANCE:
            raise SceneError(
                where, f"bounds 0 < near < far, which is {MAX_DISTANCE:g} at most", f"near {near:g}, far {far:g}"
            )
        nears.append(near)
        corners += [camera.position, camera.position + far * camera.world_to_cam[2, :3]]
    return Poses(cameras, NEAR_TO_UNIT * float(min(nears)), bounding_cube(np.stack(corners)))


def _load(path: Path) -> np.ndarray:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about files that Python 2 wrote
            # Mapped: an invalid header may claim a size beyond the memory.
            table = np.load(path, mmap_mode="r", allow_pickle=False)
    except FileNotFoundError:
        raise SceneError(path, "a file (without poses the videos are for scene=video)", "none") from None
    except Exception as error:  # numpy raises many types for broken files
        raise SceneError(path, "a numpy array", str(error)) from None
    if not isinstance(table, np.ndarray) or table.ndim != 2 or table.shape[1] != ROW or table.dtype.kind not in "fiu":
        found = f"{table.dtype} {table.shape}" if isinstance(table, np.ndarray) else "an archive"
        raise SceneError(path, f"numbers, one row of {ROW} a camera", found)
    with np.errstate(over="ignore"):  # longdouble values that overflow become infinite and are refused later
        return np.array(table, dtype=np.float64)


def _camera(block: np.ndarray, size: tuple[int, int], where: str) -> Camera:
    """block: (3, 5), see the module's docstring."""
    down, right, backwards, position, sizes = block.T
    height, width, focal = (float(value) for value in sizes)
    cam_to_world = np.eye(4)
    cam_to_world[:3] = np.stack([right, down, -backwards, position], axis=1)  # COLMAP's x, y, z
    cam_to_world = read_pose(cam_to_world, where)
    if not (focal > 0 and height > 0 and width > 0):
        raise SceneError(where, "height, width and focal length > 0", f"{height:g}, {width:g}, {focal:g}")
    scale_x, scale_y = size[0] / width, size[1] / height
    # The same image at another scale: both sides, rounded to whole pixels, have one ratio.
    if not abs(width * scale_y - size[0]) <= max(1.0, scale_y) < math.inf:
        raise SceneError(
            where,
            "the videos' {} x {} pixels or the same shape at another scale".format(*size),
            f"{width:g} x {height:g}",
        )
    return make_camera(
        where,
        lambda: Camera(*size, focal * scale_x, focal * scale_y, size[0] / 2, size[1] / 2, np.linalg.inv(cam_to_world)),
    )
