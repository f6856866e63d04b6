"""The car of synthetic drives: its way, three frontal cameras and a LiDAR on its roof, as on Waymo's.

Vehicle axes: x forward, y left, z up, the origin on the road below the rear axle.
"""

from __future__ import annotations

import numpy as np

from datasets.synthetic.world import turn
from datasets.urban.waymo.processed import OPENCV_TO_WAYMO
from rasterizer.camera import Camera

RATE = 10.0  # frames a second
SPEED = 9.0  # metres a second
LANE = -2.2  # y of the way, metres: the right lane
SWAY = 0.15, 0.02  # of the way: metres to the side, radians
FOCAL = 1.07  # × the image's width: 50 degrees from left to right
ASPECT = 2 / 3  # height over width, as 1920 x 1280
YAW = (0.0, np.radians(43.0), -np.radians(43.0))  # of cameras 0 front, 1 front left, 2 front right
PLACES = ((1.6, 0.0, 1.6), (1.5, 0.25, 1.6), (1.5, -0.25, 1.6))  # of the cameras, metres
LIDAR = (1.2, 0.0, 2.2)  # its place, metres


def vehicle_to_world(time: float) -> np.ndarray:
    """(4, 4) at a time in seconds."""
    pose = np.eye(4)
    pose[:3, :3] = turn("z", SWAY[1] * np.sin(1.3 * time))
    pose[:3, 3] = SPEED * time, LANE + SWAY[0] * np.sin(0.9 * time), 0.0
    return pose


def camera_at(number: int, time: float, width: int) -> Camera:
    """Camera `number` at a time, `width` pixels wide."""
    height = round(ASPECT * width)
    camera_to_vehicle = np.eye(4)
    camera_to_vehicle[:3, :3] = turn("z", YAW[number])
    camera_to_vehicle[:3, 3] = PLACES[number]
    camera_to_world = vehicle_to_world(time) @ camera_to_vehicle @ OPENCV_TO_WAYMO
    focal = FOCAL * width
    return Camera(width, height, focal, focal, width / 2, height / 2, np.linalg.inv(camera_to_world))
