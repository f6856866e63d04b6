"""What moves in a driving log, found in its LiDAR sweeps: for logs whose data have no masks of it.

A point moves if beams of other sweeps pass through its place: the surface was not there at another time. (The idea is
that of visibility-based removal of dynamic points, Kim and Kim, IROS 2020.) The moving points of an image, dilated and
enclosed in convex hulls, are its mask. The mask serves evaluation alone: training does not see it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy.ndimage import label, minimum_filter

from datasets.scene import Scene, Sweep, View
from datasets.urban.projection import seen
from rasterizer.camera import Camera

AZIMUTH, ELEVATION = np.radians(0.3), np.radians(0.6)  # cells of a range image; beams are spaced by 0.1 to 0.5 degrees
OTHERS = 8  # sweeps on either side that a sweep is compared with
CLEARANCE, RELATIVE_CLEARANCE = 0.5, 0.05  # metres, and part of the range, by which a beam must pass a point
FREE_VOTES, FREE_SHARE = 3, 0.7  # sweeps that saw through the place; of those that saw it free or occupied
DISC = 0.012  # radians: radius of a point's disc in the mask
FEWEST_POINTS = 8  # of a moving thing in an image


BY_LIDAR = "LiDAR points through whose place beams of other sweeps pass"


@dataclass(frozen=True)
class RangeImage:
    """The nearest range of a sweep's beams in each cell of azimuth and elevation; inf without a beam."""

    origin: np.ndarray  # (3,)
    up: np.ndarray  # (3, 3) world -> axes whose third is up
    ranges: np.ndarray  # (rows, columns)

    @classmethod
    def of(cls, sweep: Sweep, axes: np.ndarray) -> RangeImage:
        shape = round(np.pi / ELEVATION), round(2 * np.pi / AZIMUTH)
        ranges = np.full(shape, np.inf)
        row, column, distance = _cells(sweep.points, sweep.origin, axes, shape)
        np.minimum.at(ranges, (row, column), distance)
        return cls(sweep.origin, axes, minimum_filter(ranges, size=3, mode=("nearest", "wrap")))

    def compare(self, points: np.ndarray, unit: float) -> tuple[np.ndarray, np.ndarray]:
        """(free, occupied), (N,) bool: whether the beams pass through points (N, 3), or end at them. unit: world units
        per metre."""
        row, column, distance = _cells(points, self.origin, self.up, self.ranges.shape)
        found = self.ranges[row, column]
        margin = CLEARANCE * unit + RELATIVE_CLEARANCE * distance
        return np.isfinite(found) & (found > distance + margin), np.abs(found - distance) <= margin


def with_moving_masks(scene: Scene) -> Scene:
    """The scene, in metres, whose test views without a mask of what moves have one found in the sweeps.

    Unchanged where there are no sweeps, or where the data have masks.
    """
    sweeps = sorted((*scene.sweeps, *scene.test_sweeps), key=lambda sweep: sweep.time)
    if not scene.test_sweeps or any(view.moving is not None or view.truth is not None for view in scene.test):
        return scene
    axes = upright_axes([view.camera for view in scene.train])
    images = [RangeImage.of(sweep, axes) for sweep in sweeps]
    moving = {
        sweep.frame: sweep.points[moving_points(sweep, images[max(0, i - OTHERS) : i] + images[i + 1 : i + 1 + OTHERS])]
        for i, sweep in enumerate(sweeps)
        if sweep in scene.test_sweeps
    }

    def masked(view: View) -> View:
        if view.frame not in moving:
            return view
        return replace(view, moving=moving_mask(moving[view.frame], view.camera))

    return replace(scene, test=tuple(map(masked, scene.test)), moving_by=BY_LIDAR)


def moving_points(sweep: Sweep, others: Sequence[RangeImage], unit: float = 1.0) -> np.ndarray:
    """(N,) bool: which points of a sweep move, by the range images of the sweeps around it."""
    free, occupied = np.zeros(len(sweep.points), int), np.zeros(len(sweep.points), int)
    for image in others:
        is_free, is_occupied = image.compare(sweep.points, unit)
        free += is_free
        occupied += is_occupied
    return (free >= FREE_VOTES) & (free >= FREE_SHARE * (free + occupied))


def moving_mask(points: np.ndarray, camera: Camera) -> np.ndarray:
    """(H, W) bool: convex hulls around the groups of moving points (N, 3) that the camera sees."""
    mask = np.zeros((camera.height, camera.width), np.uint8)
    _, column, row, _ = seen(points, camera)
    if len(column) < FEWEST_POINTS:
        return mask > 0
    radius = max(1, round(DISC * camera.fx))
    for x, y in zip(column.astype(int).tolist(), row.astype(int).tolist()):
        cv2.circle(mask, (x, y), radius, 1, -1)
    groups, _ = label(mask)
    of_point = groups[row.astype(int), column.astype(int)]
    hulls = np.zeros_like(mask)
    for group, count in zip(*np.unique(of_point, return_counts=True)):
        if count >= FEWEST_POINTS:
            outline, _ = cv2.findContours((groups == group).astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
            cv2.fillConvexPoly(hulls, cv2.convexHull(np.concatenate(list(outline))), 1)
    return hulls > 0


def upright_axes(cameras: Sequence[Camera]) -> np.ndarray:
    """(3, 3) rotation from the world to axes whose third is up: against the mean of the cameras' down axes."""
    down = np.mean([camera.world_to_cam[1, :3] for camera in cameras], axis=0)
    up = -down / np.linalg.norm(down)
    aside = np.cross(up, np.eye(3)[np.abs(up).argmin()])
    aside /= np.linalg.norm(aside)
    return np.stack([aside, np.cross(up, aside), up])


def _cells(
    points: np.ndarray, origin: np.ndarray, axes: np.ndarray, shape: tuple[int, ...]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(row, column, distance) of points (N, 3) in a range image."""
    x, y, z = axes @ (points - origin).T
    distance = np.sqrt(x * x + y * y + z * z)
    elevation = np.arcsin(np.clip(z / np.maximum(distance, 1e-9), -1, 1))
    row = ((elevation + np.pi / 2) / np.pi * shape[0]).astype(int).clip(0, shape[0] - 1)
    column = ((np.arctan2(y, x) + np.pi) / (2 * np.pi) * shape[1]).astype(int) % shape[1]
    return row, column, distance
