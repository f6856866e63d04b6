"""Initial points of a driving log: those of all LiDAR sweeps, each at its sweep's time, thinned to a budget; and points
for what no LiDAR reaches, drawn along the rays of pixels above its beams."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from datasets.scene import Scene, Sweep, View
from datasets.urban.projection import depth_image, seen
from pipeline.data.lidar.velocities import sweep_velocities

MOST_POINTS = 1_000_000  # before thinning: more change no voxel's choice noticeably
VOXEL_STEPS = 24  # of the bisection: the voxel is found within 1e-5 of its size
FAR_SHARE = 0.25  # of the points: for what no beam reaches, above the highest one
SPREAD = 0.1  # standard deviation of the logarithm of a far point's depth around that of the LiDAR below
FAR_RANGE = (20.0, 200.0)  # metres, log-uniform: far points of columns without LiDAR


@dataclass(frozen=True)
class TimedPoints:
    """Points with colours and times."""

    points: np.ndarray  # (N, 3) world units
    times: np.ndarray  # (N,) the scene's unit
    colors: np.ndarray  # (N, 3) uint8
    velocities: np.ndarray  # (N, 3) world units per unit of time

    def rows(self, index: np.ndarray) -> TimedPoints:
        return TimedPoints(*(array[index] for array in vars(self).values()))


def initial_points(scene: Scene, budget: int, rng: np.random.Generator, velocities: bool = True) -> TimedPoints:
    """`budget` points at most: (1 - FAR_SHARE) of them from LiDAR, the rest far points.

    velocities: measured between sweeps (velocities.py); else all zero.
    Deterministic in `rng`. Raises ValueError if no camera sees a LiDAR point.
    """
    far_count = round(budget * FAR_SHARE)
    lidar = thinned(coloured_points(scene, rng, velocities), budget - far_count, rng)
    return joined([lidar, far_points(scene, far_count, rng)])


def coloured_points(scene: Scene, rng: np.random.Generator, velocities: bool = True) -> TimedPoints:
    """The LiDAR points of the training frames that a camera of their frame sees, in its colour. Of points that several
    see the colour is the first camera's."""
    found: list[TimedPoints] = []
    moving = sweep_velocities(scene) if velocities else [np.zeros_like(sweep.points) for sweep in scene.sweeps]
    for sweep, velocity in zip(scene.sweeps, moving):
        left = np.ones(len(sweep.points), dtype=bool)
        for view in (view for view in scene.train if view.frame == sweep.frame):
            index, column, row, _ = seen(sweep.points, view.camera)
            new = left[index]
            index, column, row = index[new], column[new].astype(int), row[new].astype(int)
            left[index] = False
            colors = np.asarray(view.image)[row, column]
            found.append(TimedPoints(sweep.points[index], np.full(len(index), sweep.time), colors, velocity[index]))
    if not sum(len(part.points) for part in found):
        raise ValueError(f"{scene.source}: expected LiDAR points in the images of their frame, found none")
    cloud = joined(found)
    if len(cloud.points) > MOST_POINTS:
        cloud = cloud.rows(np.sort(rng.choice(len(cloud.points), MOST_POINTS, replace=False)))
    return cloud


def thinned(cloud: TimedPoints, budget: int, rng: np.random.Generator) -> TimedPoints:
    """One random point of each voxel, with voxels of the smallest size that leaves at most `budget` points.

    Voxels are of space alone: what stands still is not repeated for every sweep, and what moves fills the voxels that
    it passes with points of the time at which it does.
    """
    if len(cloud.points) <= budget:
        return cloud
    order = rng.permutation(len(cloud.points))
    points = cloud.points[order]
    low, high = 0.0, float(np.ptp(points, axis=0).max())
    chosen = np.arange(1)
    for _ in range(VOXEL_STEPS):
        side = 0.5 * (low + high)
        first = first_in_voxels(points, side)
        if len(first) <= budget:
            high, chosen = side, first
        else:
            low = side
    return cloud.rows(np.sort(order[chosen]))


def first_in_voxels(points: np.ndarray, side: float) -> np.ndarray:
    """Index of the first point (N, 3) in each occupied voxel."""
    cells = np.floor((points - points.min(axis=0)) / max(side, 1e-12)).astype(np.int64)
    spans = cells.max(axis=0) + 1
    if float(spans[0]) * float(spans[1]) * float(spans[2]) > 2.0**62:
        return np.arange(len(points))  # voxels this small hold a point each
    keys = (cells[:, 0] * spans[1] + cells[:, 1]) * spans[2] + cells[:, 2]
    return np.unique(keys, return_index=True)[1]


def far_points(scene: Scene, count: int, rng: np.random.Generator) -> TimedPoints:
    """`count` points at pixels that show no sky above the LiDAR's highest beam, in the colour and at the time of the
    image: at the depth of the LiDAR below them, as house fronts and trees are, with some spread."""
    views = [view for view in scene.train if view.frame is not None]
    sweeps = {sweep.frame: sweep for sweep in scene.sweeps}
    per_view = np.bincount(rng.integers(len(views), size=count), minlength=len(views)) if views else np.zeros(0, int)
    parts = [
        _far_points_of(view, sweeps.get(view.frame or 0), wanted, scene.metre or 1.0, rng)
        for view, wanted in zip(views, per_view)
        if wanted
    ]
    return joined([nothing(), *parts])


def _far_points_of(view: View, sweep: Sweep | None, count: int, metre: float, rng: np.random.Generator) -> TimedPoints:
    camera = view.camera
    height, width = camera.height, camera.width
    depth = np.zeros((height, width), np.float32) if sweep is None else depth_image(sweep.points, camera)
    top, depth_at_top = highest_beam(depth)
    free = np.arange(height)[:, None] < top
    if view.sky is not None:
        free &= ~view.sky
    candidates = np.flatnonzero(free)
    if not len(candidates):
        return nothing()
    row, column = np.divmod(rng.choice(candidates, count), width)
    low, high = np.log(FAR_RANGE)
    metres = np.exp(rng.uniform(low, high, count)) * metre
    known = depth_at_top[column]
    z = np.where(known > 0, known * np.exp(SPREAD * rng.standard_normal(count)), metres)
    rays = np.stack(
        [(column + 0.5 - camera.cx) / camera.fx, (row + 0.5 - camera.cy) / camera.fy, np.ones(count)], axis=1
    )
    points = camera.position + (z[:, None] * rays) @ camera.world_to_cam[:3, :3]
    colors = np.asarray(view.image)[row, column]
    return TimedPoints(points, np.full(count, view.time), colors, np.zeros_like(points))


def highest_beam(depth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(row of the highest point, its depth), (W,) each, of a sparse depth image (H, W); where a column has none those
    of the nearest column that has one; (H, 0) without any."""
    height, width = depth.shape
    hit = (depth > 0).any(axis=0)
    if not hit.any():
        return np.full(width, height), np.zeros(width)
    columns = np.flatnonzero(hit)
    nearest = columns[np.abs(np.arange(width)[:, None] - columns).argmin(axis=1)]
    top = (depth > 0).argmax(axis=0)[nearest]
    return top, depth[top, nearest]


def joined(parts: list[TimedPoints]) -> TimedPoints:
    """One after the other."""
    return TimedPoints(*(np.concatenate(arrays) for arrays in zip(*(vars(part).values() for part in parts))))


def nothing() -> TimedPoints:
    return TimedPoints(np.zeros((0, 3)), np.zeros(0), np.zeros((0, 3), np.uint8), np.zeros((0, 3)))
