"""Outliers among positions: what a single wrong row must not decide.

Only a gap makes an outlier: a position more than GAP times as far from the median as all that are nearer. Paths, rings,
rows and clusters have no such gap, so that nothing that is computed from them changes.
"""

from __future__ import annotations

import numpy as np

GAP = 10.0  # × the distance of the last one before the gap
MOST = 0.3  # of the different positions are outliers, but one is always allowed
FEWEST = 5  # different positions: of fewer none can be told from the others


def inliers(positions: np.ndarray) -> np.ndarray:
    """(N,) bool: which of the positions (N, 3) are no outliers. All of one position are one."""
    different, row_of = np.unique(positions, axis=0, return_inverse=True)
    distances = np.linalg.norm(different - np.median(different, axis=0), axis=1)
    ascending = np.sort(distances)
    most = max(1, int(MOST * len(different)))
    tail = ascending[len(ascending) - most - 1 :]
    gaps = np.flatnonzero(tail[1:] > GAP * tail[:-1])
    if len(different) < FEWEST or not len(gaps) or tail[gaps[0]] == 0:
        return np.ones(len(positions), dtype=bool)
    return (distances <= tail[gaps[0]])[row_of.ravel()]


def without_outliers(positions: np.ndarray) -> np.ndarray:
    """The positions that are no outliers; the same array where there are none."""
    kept = inliers(positions)
    return positions if kept.all() else positions[kept]
