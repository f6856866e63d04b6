"""Poses from KITTI's GPS/IMU packets: Mercator coordinates and roll, pitch, yaw."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from datasets.files.errors import SceneError

EARTH_RADIUS = 6378137.0  # metres
LATITUDE, LONGITUDE, ALTITUDE, ROLL, PITCH, YAW = range(6)  # of the 30 values; degrees, metres, radians


def poses_of_oxts(rows: np.ndarray, where: Path) -> list[np.ndarray]:
    """IMU-to-world (4, 4) for each row (30,); the world is the IMU's frame at the first row.

    x = s r lon, y = s r ln tan(π (90 + lat) / 360), s = cos(lat₀): the Mercator map is scaled to metres at the first
    row's latitude. R = Rz(yaw) Ry(pitch) Rx(roll).
    """
    latitude = rows[:, LATITUDE]
    if not (np.abs(latitude) < 89).all():
        raise SceneError(where, "latitudes below 89 degrees", f"{float(np.abs(latitude).max()):g}")
    scale = np.cos(np.radians(latitude[0])) * EARTH_RADIUS
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    poses[:, 0, 3] = scale * np.radians(rows[:, LONGITUDE])
    poses[:, 1, 3] = scale * np.log(np.tan(np.pi * (90 + latitude) / 360))
    poses[:, 2, 3] = rows[:, ALTITUDE]
    poses[:, :3, :3] = Rotation.from_euler("ZYX", rows[:, [YAW, PITCH, ROLL]]).as_matrix()
    return list(np.linalg.inv(poses[0]) @ poses)
