"""Velocities of what moves, measured between LiDAR sweeps: initial points start with the motion of their surface.

The points that move (datasets/urban/moving.py) form groups. A group is carried along the ground to the sweep before and
to the next one, where most of its points find neighbours; both ways must agree. Ours, not the paper's: from images
alone a Gaussian that moves is hardly told from a row of Gaussians that appear one after another.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from datasets.scene import Scene
from datasets.urban.moving import OTHERS, RangeImage, moving_points, upright_axes

GROUP_RADIUS = 0.8  # metres between neighbours of a group
FEWEST_POINTS = 8  # of a group
MOST_POINTS = 500  # of a group that are compared
LARGEST_SPEED = 40.0  # metres a second
CLOSE = 0.6  # metres: a point found again
FOUND_SHARE = 0.6  # of a group's points that must be found again
AGREEMENT = 2.5  # metres a second between the velocities to the sweep before and to the next
STEPS = 8  # of the alignment


def sweep_velocities(scene: Scene) -> list[np.ndarray]:
    """For each training sweep the velocities (N, 3) of its points, world units per unit of time; 0 where nothing is
    known to move."""
    metre, sweeps = scene.metre or 1.0, scene.sweeps
    axes = upright_axes([view.camera for view in scene.train])
    images = [RangeImage.of(sweep, axes) for sweep in sweeps]
    moving = [
        moving_points(sweep, images[max(0, i - OTHERS) : i] + images[i + 1 : i + 1 + OTHERS], metre)
        for i, sweep in enumerate(sweeps)
    ]
    found = [np.zeros_like(sweep.points) for sweep in sweeps]
    for i, sweep in enumerate(sweeps):
        index = np.flatnonzero(moving[i])
        if not len(index):
            continue
        for group in groups(sweep.points[index], GROUP_RADIUS * metre):
            points = sweep.points[index[group]]
            measured: list[np.ndarray | None] = []
            for other in (i - 1, i + 1):
                if 0 <= other < len(sweeps):
                    step = sweeps[other].time - sweep.time
                    reach = LARGEST_SPEED * metre * scene.seconds_per_unit * abs(step)
                    shift = displacement(points, sweeps[other].points[moving[other]], axes[2], reach, metre)
                    measured.append(None if shift is None else shift / step)
            found[i][index[group]] = agreed(measured, AGREEMENT * metre * scene.seconds_per_unit)
    return found


def agreed(velocities: list[np.ndarray | None], tolerance: float) -> np.ndarray:
    """(3,) the mean of velocities that are all known and within `tolerance` of each other; else zero."""
    known = [velocity for velocity in velocities if velocity is not None]
    if not known or len(known) < len(velocities):
        return np.zeros(3)
    apart = max(float(np.linalg.norm(a - b)) for a in known for b in known)
    return np.mean(known, axis=0) if apart <= tolerance else np.zeros(3)


def groups(points: np.ndarray, radius: float) -> list[np.ndarray]:
    """Indices of points (N, 3) in groups whose neighbours are within `radius`, of FEWEST_POINTS at least."""
    pairs = cKDTree(points).sparse_distance_matrix(cKDTree(points), radius, output_type="coo_matrix")
    count, label = connected_components(pairs, directed=False)
    found = [np.flatnonzero(label == group) for group in range(count)]
    return [group for group in found if len(group) >= FEWEST_POINTS]


def displacement(
    points: np.ndarray, later: np.ndarray, up: np.ndarray, reach: float, metre: float
) -> np.ndarray | None:
    """(3,) the shift along the ground, at most `reach` long, that carries `points` (N, 3) onto `later` (M, 3); None if
    none fits.

    Beams are farther apart than a car is high, so that heights say nothing about its motion.

    Starts from the shift onto the centre of each group of `later` within reach, aligns by nearest neighbours, and takes
    the one that finds the largest share of points again.
    """
    points = points[:: max(1, len(points) // MOST_POINTS)]
    if not len(later):
        return None
    tree, centre, level = cKDTree(later), points.mean(axis=0), np.eye(3) - np.outer(up, up)
    best, best_share = None, FOUND_SHARE
    for group in groups(later, GROUP_RADIUS * metre):
        shift = level @ (later[group].mean(axis=0) - centre)
        if np.linalg.norm(shift) > reach:
            continue
        for _ in range(STEPS):
            distance, nearest = tree.query(points + shift)
            close = distance <= max(CLOSE * metre, float(np.quantile(distance, 0.5)))
            shift = shift + level @ np.mean(later[nearest[close]] - (points[close] + shift), axis=0)
        share = float((tree.query(points + shift)[0] <= CLOSE * metre).mean())
        if share > best_share and np.linalg.norm(shift) <= reach:
            best, best_share = shift, share
    return best
