"""The camera rig of filmed scenes: static cameras on a slightly curved grid, all looking at the origin.

Like the rig of the Plenoptic Video data set: some twenty cameras in two or three rows. Camera 0, which is usually held
out, is in the middle, so that its view interpolates the others.
"""

from __future__ import annotations

import numpy as np

from datasets.files.errors import SceneError
from datasets.synthetic.camera_path import look_at_origin
from rasterizer.camera import Camera

RADIUS = 3.0  # from the origin, which all cameras look at; world units
HALF_WIDTH, HALF_HEIGHT = 0.6, 0.25  # of the grid, world units along its arc
ELEVATION = 0.19  # of the middle row, radians
FOCAL = 0.85  # × the image's width: 61 degrees from left to right
JITTER = 0.02  # of the positions, world units, standard deviation
ROLL = 0.01  # about the viewing axis, radians, standard deviation


def rig(count: int, width: int, height: int, rng: np.random.Generator) -> list[Camera]:
    """`count` >= 3 cameras of width × height pixels and one focal length, camera 0 in the middle."""
    if count < 3:
        raise SceneError("scene.cameras", "at least 3", str(count))
    across, upward = grid(count).T + rng.normal(scale=JITTER, size=(2, count))
    azimuth, elevation = across / RADIUS, ELEVATION + upward / RADIUS
    places = RADIUS * np.stack(
        [np.cos(elevation) * np.sin(azimuth), -np.cos(elevation) * np.cos(azimuth), np.sin(elevation)], axis=-1
    )
    return [
        Camera.from_blender(width, height, FOCAL * width, look_at_origin(place) @ _roll(angle))
        for place, angle in zip(places, rng.normal(scale=ROLL, size=count))
    ]


def grid(count: int) -> np.ndarray:
    """Grid positions (count, 2) right and up, world units: the centre first, then row by row from the top."""
    others = count - 1
    middle = 2 * max(1, round(others / 6))  # as many on either side of the centre
    top = (others - middle + 1) // 2
    places = [(0.0, 0.0)]
    for row, upward in ((top, HALF_HEIGHT), (middle + 1, 0.0), (others - middle - top, -HALF_HEIGHT)):
        # From edge to edge; a single camera is in the middle.
        across = HALF_WIDTH * (2 * np.arange(row) - (row - 1)) / max(row - 1, 1)
        places += [(x, upward) for x in across if (x, upward) != places[0]]
    return np.array(places)


def _roll(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
