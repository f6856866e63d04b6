"""The visual hull of what moves: the space inside the silhouettes of all cameras, refined from coarse cells."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from datasets.scene import Box
from datasets.urban.projection import in_image, project
from rasterizer.camera import Camera

COARSE = 16  # cells along the longest side of the box
LEVELS = 5  # at most: each halves the cells
FINEST = 1.5  # pixels: cells are not made smaller
FEWEST = 2  # cameras that see a cell
MOST_CELLS = 400_000  # of a level: silhouettes that are everywhere say nothing finer


def hull(silhouettes: Sequence[np.ndarray], cameras: Sequence[Camera], box: Box) -> tuple[np.ndarray, float]:
    """(N, 3) middles of the cells at the surface, world units, and their side; N = 0 where no place is in all.

    silhouettes: (h, w) bool of each camera. A camera that does not see a cell says nothing about it.
    """
    # Of each pixel the distance to the silhouette, pixels.
    away = [
        cv2.distanceTransform((~inside).astype(np.uint8), cv2.DIST_L2, 3)
        if inside.any()
        else np.full(inside.shape, np.inf)
        for inside in silhouettes
    ]
    low, high = (np.broadcast_to(np.asarray(corner, np.float64), 3) for corner in box)
    cell = float((high - low).max()) / COARSE
    counts = np.ceil((high - low) / cell).astype(int)
    index = np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), axis=-1).reshape(-1, 3)
    for level in range(LEVELS + 1):
        points = low + cell * (index + 0.5)
        inside, pixels = _inside(points, cell, away, cameras)
        index = index[inside]
        if not len(index) or level == LEVELS or pixels <= FINEST or 8 * len(index) > MOST_CELLS:
            break
        corners = np.stack(np.meshgrid(*[[0, 1]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
        index, cell = (2 * index[:, None] + corners).reshape(-1, 3), cell / 2
    return low + cell * (index[_at_surface(index)] + 0.5), cell


def _inside(
    points: np.ndarray, cell: float, away: Sequence[np.ndarray], cameras: Sequence[Camera]
) -> tuple[np.ndarray, float]:
    """(N,) bool: cells that may be in all silhouettes; and the largest side of a cell in an image, pixels."""
    kept, seeing, largest = np.ones(len(points), bool), np.zeros(len(points), int), 0.0
    for distance, camera in zip(away, cameras):
        column, row, depth = project(points, camera)
        seen = in_image(column, row, depth, camera)
        seeing += seen
        side = cell * camera.fx / depth[seen]
        inside = distance[row[seen].astype(int), column[seen].astype(int)] <= np.maximum(0.87 * side, 0.5)
        kept[seen] &= inside
        largest = max(largest, float(side[inside].max(initial=0.0)))
    return kept & (seeing >= FEWEST), largest


def _at_surface(index: np.ndarray) -> np.ndarray:
    """(N,) bool: cells (N, 3) without one of their six neighbours."""
    if not len(index):
        return np.zeros(0, bool)
    size = index.max(axis=0) + 3
    full = np.zeros(size, bool)
    x, y, z = (index + 1).T
    full[x, y, z] = True
    around = [full[x + i, y + j, z + k] for i, j, k in np.concatenate([np.eye(3, dtype=int), -np.eye(3, dtype=int)])]
    return ~np.all(around, axis=0)
