"""Optical axes of cameras: their least-squares intersection and their mean direction."""

from __future__ import annotations

import numpy as np

# Below this angle between the axes (root mean square, to their mean) they count as parallel.
SMALLEST_ANGLE_DEG = 2.0

# Length of the mean of the unit vectors below which the cameras have no common direction, as on a ring around a scene.
SMALLEST_MEAN_DIRECTION = 0.5


def intersect_axes(positions: np.ndarray, directions: np.ndarray) -> np.ndarray | None:
    """The point (3,) with the least sum of squared distances to all optical axes.

    positions: (C, 3). directions: (C, 3) unit vectors. None if the axes are nearly parallel, or if the point lies
    behind most cameras.
    """
    projections = np.eye(3) - directions[:, :, None] * directions[:, None, :]  # (C, 3, 3) onto the normal planes
    system = projections.mean(axis=0)
    # The smallest eigenvalue is the mean squared sine of the angle between the axes and their common direction.
    if np.linalg.eigvalsh(system)[0] < np.sin(np.radians(SMALLEST_ANGLE_DEG)) ** 2:
        return None
    point = np.linalg.solve(system, np.einsum("nij,nj->i", projections, positions) / len(positions))
    depths = np.sum((point - positions) * directions, axis=1)
    return point if np.median(depths) > 0 else None


def mean_direction(directions: np.ndarray) -> np.ndarray | None:
    """Mean of the unit vectors `directions` (C, 3), normalised (3,); None if it is shorter than the bound above."""
    mean = directions.mean(axis=0)
    length = np.linalg.norm(mean)
    return mean / length if length > SMALLEST_MEAN_DIRECTION else None
