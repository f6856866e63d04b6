"""Poses that were read the wrong way round: as world-to-camera where they are camera-to-world, or with flipped axes.

Of cameras that look at one thing such a reading makes cameras whose optical axes meet behind them. Cameras that do look
outwards have such axes, too: what other readings would make of the poses is a suspicion, which images can prove.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from datasets.camera_box import distinct
from datasets.canonical import intersect_axes
from datasets.scene import camera_extent
from datasets.urban.projection import in_image, project
from rasterizer.camera import Camera

FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
FEWEST = 3  # cameras: two axes nearly always meet somewhere
SHARE = 0.9  # of the cameras have the point that they look at in their image
NEAREST = 0.5  # of the cameras' extent, to that point; the axes of a wrong reading may meet among cameras that cluster


def other_readings(cameras: Sequence[Camera]) -> dict[str, list[Camera]]:
    """What may have been read wrongly -> the cameras in that reading, of those by which they look at one point."""
    readings = {
        "camera-to-world and world-to-camera exchanged": np.linalg.inv,
        "the cameras' y and z axes reversed (OpenGL's or OpenCV's)": lambda pose: FLIP @ pose,
        "both exchanged, and y and z reversed": lambda pose: FLIP @ np.linalg.inv(pose),
    }
    found = {name: [replace(c, world_to_cam=read(c.world_to_cam)) for c in cameras] for name, read in readings.items()}
    return {name: reread for name, reread in found.items() if look_at_one_point(reread)}


def look_at_one_point(cameras: Sequence[Camera]) -> bool:
    """Whether the optical axes meet in front of the cameras, in the images of nearly all of three or more."""
    cameras = distinct(cameras)
    positions = np.stack([camera.position for camera in cameras])
    middle = positions.mean(axis=0)
    target = intersect_axes(positions - middle, np.stack([camera.world_to_cam[2, :3] for camera in cameras]))
    if target is None or len(cameras) < FEWEST:
        return False
    seen = [bool(in_image(*project((middle + target)[None], camera), camera)[0]) for camera in cameras]
    distance = float(np.median(np.linalg.norm(positions - middle - target, axis=1)))
    return float(np.mean(seen)) >= SHARE and distance >= NEAREST * camera_extent(cameras)
