"""Where the scene is by its cameras alone: the box that most of them see, where they look at something in common.

Coordinates are those of the cameras. The result shifts and scales with them, so that it does not depend on their unit.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from datasets.canonical import intersect_axes
from datasets.outliers import inliers
from datasets.scene import Box
from rasterizer.camera import Camera

MOST = 0.75  # of the cameras see a point of the box
# Depths in which a camera sees it, × the depth of the point that the cameras look at: nearer than half of it nothing is
# seen by most; cameras on one side would see it without end.
NEAREST, FARTHEST = 0.2, 2.0
REACH = 2.5  # half of the side of the cube that is looked at, × the cameras' median distance from that point
CELLS = 24  # of the grid, along each axis; it is laid a second time, over what the first has found
MOST_CAMERAS = 100  # evenly chosen ones suffice


def box_of_cameras(cameras: Sequence[Camera]) -> Box | None:
    """The axis-aligned box around the points that MOST of the cameras see, in the cameras' coordinates.

    None where that is no box: optical axes that are nearly parallel, or that meet behind the cameras or out of sight,
    as of cameras that look outwards or along a way. Cameras that are outliers do not count, nor does one that takes
    several views count several times.
    """
    cameras = distinct(cameras)
    positions = np.stack([camera.position for camera in cameras])
    middle = positions.mean(axis=0)
    target = intersect_axes(positions - middle, np.stack([camera.world_to_cam[2, :3] for camera in cameras]))
    if target is None:
        return None
    target = target + middle
    reach = REACH * float(np.median(np.linalg.norm(positions - target, axis=1)))
    low, high = target - reach, target + reach
    for _ in range(2):
        cell = (high - low) / CELLS
        axes = [low[i] + cell[i] * (np.arange(CELLS) + 0.5) for i in range(3)]
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        found = grid[share_that_sees(grid, cameras, target) >= MOST]
        if not len(found):
            return None
        low, high = found.min(axis=0) - cell, found.max(axis=0) + cell
    low, high = low + 0.5 * cell, high - 0.5 * cell  # the faces of the cells
    return tuple(low.tolist()), tuple(high.tolist())


def share_that_sees(points: np.ndarray, cameras: Sequence[Camera], target: np.ndarray) -> np.ndarray:
    """(N,) share of the cameras that have each of the points (N, 3) in their image, at a depth between NEAREST and
    FARTHEST × that of `target` (3,). Cameras behind which it lies see none."""
    seen = np.zeros(len(points))
    for camera in cameras:
        x, y, z = camera.world_to_cam[:3, :3] @ points.T + camera.world_to_cam[:3, 3:]
        depth = float(camera.world_to_cam[2, :3] @ target + camera.world_to_cam[2, 3])
        with np.errstate(divide="ignore", invalid="ignore"):
            column, row = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
        inside = (column > 0) & (column < camera.width) & (row > 0) & (row < camera.height)
        seen += inside & (z > NEAREST * depth) & (z < FARTHEST * depth)
    return seen / len(cameras)


def distinct(cameras: Sequence[Camera]) -> list[Camera]:
    """At most MOST_CAMERAS of the cameras of different poses, without outliers, in their order."""
    different = list({camera.world_to_cam.tobytes(): camera for camera in cameras}.values())
    kept = inliers(np.stack([camera.position for camera in different]))
    different = [camera for camera, inside in zip(different, kept) if inside]
    return different[:: -(-len(different) // MOST_CAMERAS)]
