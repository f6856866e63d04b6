"""Where the scene is by its cameras alone.

A box that most of them see, where they look at something in common; a band of depths before each, where they look
outwards, side by side or along their way. Coordinates are those of the cameras. The result shifts and scales with them,
so that it does not depend on their unit.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from datasets.canonical import intersect_axes
from datasets.outliers import inliers
from datasets.scene import Box, camera_extent
from rasterizer.camera import Camera

MOST = 0.75  # of the cameras see a point of the box
# Depths in which a camera sees it, × the depth of the point that the cameras look at: nearer than half of it nothing is
# seen by most; cameras on one side would see it without end.
NEAREST, FARTHEST = 0.2, 2.0
REACH = 2.5  # half of the side of the cube that is looked at, × the cameras' median distance from that point
CELLS = 24  # of the grid, along each axis; it is laid a second time, over what the first has found
MOST_CAMERAS = 100  # evenly chosen ones suffice
# Of the band of depths, × the cameras' extent. What is nearer than half of it a row of cameras does not share; cameras
# that move ahead pass by what they see. Beyond the last the rays of the cameras are nearly parallel: the sky.
NEAR_BESIDE, NEAR_AHEAD, FAR = 0.5, 0.02, 10.0
AHEAD = 0.7  # mean cosine between the way and the optical axes, from which cameras move ahead or back
# A usual cube is kept where its sides are those of the box up to this factor, and its middle within a quarter of them.
ALIKE, OFF = 2.0, 0.25


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


def band_of_depths(cameras: Sequence[Camera]) -> tuple[float, float]:
    """(near, far) of what cameras whose axes do not meet see, in the cameras' unit."""
    cameras = distinct(cameras)
    extent = camera_extent(cameras)
    way = np.linalg.svd(np.stack([c.position for c in cameras]) - np.mean([c.position for c in cameras], axis=0))[2][0]
    along = float(np.mean([abs(camera.world_to_cam[2, :3] @ way) for camera in cameras]))
    return (NEAR_AHEAD if along > AHEAD else NEAR_BESIDE) * extent, FAR * extent


def box_around_frusta(cameras: Sequence[Camera], far: float) -> Box:
    """The box around the cameras and all that they see up to a depth, for cameras whose axes do not meet."""
    corners = []
    for camera in distinct(cameras):
        sides = ((0, 0), (camera.width, 0), (0, camera.height), (camera.width, camera.height))
        rays = np.array([((x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, 1.0) for x, y in sides])
        corners += [camera.position, *(camera.position + far * rays @ camera.world_to_cam[:3, :3])]
    low, high = np.min(corners, axis=0), np.max(corners, axis=0)
    return tuple(low.tolist()), tuple(high.tolist())


def are_alike(usual: Box, box: Box) -> bool:
    """Whether the cameras' box bears out a usual one, which is then as good."""
    low, high, own_low, own_high = (np.broadcast_to(corner, 3) for corner in (*usual, *box))
    ratio = (own_high - own_low) / (high - low)
    off = np.abs(own_low + own_high - low - high) / 2 / (high - low)
    return bool((ratio < ALIKE).all() and (ratio > 1 / ALIKE).all() and (off <= OFF).all())


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
