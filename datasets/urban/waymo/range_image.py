"""Waymo's range images: from a laser's range at each inclination and azimuth to points."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation


def inclinations(values: np.ndarray | None, low: float, high: float, rows: int) -> np.ndarray:
    """(rows,) radians, from the first row, the highest, down: the given beams, or evenly spaced ones."""
    beams = low + (np.arange(rows) + 0.5) / rows * (high - low) if values is None or not len(values) else values
    return np.asarray(beams, dtype=np.float64)[::-1]


def points_of(
    ranges: np.ndarray,
    beams: np.ndarray,
    laser_to_vehicle: np.ndarray,
    pixel_poses: np.ndarray | None = None,
    vehicle_to_world: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(points (N, 3), beams' origins (N, 3), index (N,) of the pixel) in the vehicle's frame; of ranges (H, W) > 0.

    Column j of W looks to azimuth (2 (W - j - ½) / W - 1) π - atan2(E₁₀, E₀₀) with E = laser_to_vehicle: the last
    column to the left of straight behind. beams: (H,) by `inclinations`. pixel_poses: (H, W, 6) roll, pitch, yaw, x, y,
    z of the vehicle in the world while the pixel was measured, with vehicle_to_world (4, 4) of the frame; None: the
    vehicle's frame is that of the pixel.
    """
    height, width = ranges.shape
    correction = np.arctan2(laser_to_vehicle[1, 0], laser_to_vehicle[0, 0])
    azimuth = (2 * (width - np.arange(width) - 0.5) / width - 1) * np.pi - correction
    index = np.flatnonzero(ranges > 0)
    row, column = np.divmod(index, width)
    up, around, distance = beams[row], azimuth[column], ranges.reshape(-1)[index].astype(np.float64)
    local = distance[:, None] * np.stack([np.cos(around) * np.cos(up), np.sin(around) * np.cos(up), np.sin(up)], axis=1)
    points = local @ laser_to_vehicle[:3, :3].T + laser_to_vehicle[:3, 3]
    origins = np.tile(laser_to_vehicle[:3, 3], (len(points), 1))
    if pixel_poses is None or vehicle_to_world is None:
        return points, origins, index
    poses = pixel_poses.reshape(-1, 6)[index].astype(np.float64)
    turns = Rotation.from_euler("ZYX", poses[:, [2, 1, 0]])
    world_to_vehicle = np.linalg.inv(vehicle_to_world)

    def in_frame(of_pixel: np.ndarray) -> np.ndarray:
        world = turns.apply(of_pixel) + poses[:, 3:]
        return world @ world_to_vehicle[:3, :3].T + world_to_vehicle[:3, 3]

    return in_frame(points), in_frame(origins), index
