"""Where cameras look: the point in which their optical axes meet, if they do."""

from __future__ import annotations

import numpy as np

# Axes that meet at less than this angle (root mean square, to their mean) say nothing about where.
SMALLEST_ANGLE_DEG = 2.0

# Cameras around the scene look at each other and have no mean direction: the length of the mean of their unit vectors.
SMALLEST_MEAN_DIRECTION = 0.5


def axes_meet(positions: np.ndarray, directions: np.ndarray) -> np.ndarray | None:
    """The point nearest to all optical axes, (3,), in the sense of least squares; None where that says little.

    positions: (C, 3); directions: (C, 3) unit vectors. Little: axes almost parallel, or a point behind most cameras.
    """
    across = np.eye(3) - directions[:, :, None] * directions[:, None, :]  # (C, 3, 3) projections off the axes
    system = across.mean(axis=0)
    # The smallest eigenvalue is the mean squared sine of the angle between the axes and the direction they share.
    if np.linalg.eigvalsh(system)[0] < np.sin(np.radians(SMALLEST_ANGLE_DEG)) ** 2:
        return None
    point = np.linalg.solve(system, np.einsum("nij,nj->i", across, positions) / len(positions))
    depths = np.sum((point - positions) * directions, axis=1)
    return point if np.median(depths) > 0 else None


def mean_direction(directions: np.ndarray) -> np.ndarray | None:
    """The unit vector (3,) that `directions` (C, 3) share; None where they point all around."""
    mean = directions.mean(axis=0)
    length = np.linalg.norm(mean)
    return mean / length if length > SMALLEST_MEAN_DIRECTION else None
