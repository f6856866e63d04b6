"""Whether poses are world-to-camera, and with which axes, by what the cameras of a rig see.

A reading fits if the place nearest to all optical axes is in the images of nearly all cameras, in front of them. Where
several fit, as with the world in one of the cameras, the rays to what moves decide (moving.py). Of a format that
defines its poses another reading that alone fits is an error of the file. Of others it is taken.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from datasets.calibrations.moving import meeting_angle, small_size
from datasets.calibrations.rig import Rig
from datasets.canonical import intersect_axes
from datasets.files.errors import SceneError
from datasets.source import Log
from datasets.urban.projection import in_image, project
from rasterizer.camera import Camera

SEEING = 0.8  # of the cameras
LARGEST_ANGLE = 8.0  # degrees by which rays to one thing miss each other: its middle differs from side to side
DECISIVE = 0.5  # of the angle of the next best reading. Measured on two real rigs: 0.7 to 5.9, 3.6 to nothing
PARALLEL = 10.0  # degrees to the mean axis
SAME_PLACE = 1e-6  # of the rig's size
Places = Mapping[str, np.ndarray]  # by camera: (T, 2) pixels
Y_UP = np.diag([1.0, -1.0, -1.0, 1.0])  # OpenGL's and Blender's camera axes


@dataclass(frozen=True)
class Reading:
    """One way to read the poses of a file."""

    name: str
    to_cam: bool = True
    y_up: bool = False

    def pose(self, stated: np.ndarray) -> np.ndarray:
        """(4, 4) world-to-camera, COLMAP's axes."""
        if not self.to_cam:
            stated = np.linalg.inv(stated)
        return Y_UP @ stated if self.y_up else stated


READINGS = (
    Reading("world-to-camera"),
    Reading("camera-to-world", to_cam=False),
    Reading("world-to-camera with y up and z backward", y_up=True),
    Reading("camera-to-world with y up and z backward", to_cam=False, y_up=True),
)


def checked(
    rig: Rig, cameras: Mapping[str, Camera], where: str, log: Log, moving: Callable[[], Places | None] = lambda: None
) -> dict[str, Camera]:
    """The cameras in the reading that fits, with a line. cameras: by name, as the file states them.

    moving: looks where something moves: of each camera `moving.middles`, in pixels of `moving.small_size`. SceneError,
    with what the readings give, where none fits, two do, or the format has another; also for two cameras at one place.
    """
    _refuse_twins(cameras, where)
    if len(cameras) < 2:
        raise SceneError(where, "the poses of two cameras or more", f"{len(cameras)}")
    read = {
        r: {name: replace(camera, world_to_cam=r.pose(camera.world_to_cam)) for name, camera in cameras.items()}
        for r in READINGS
    }
    seeing = {reading: seen_by(list(those.values())) for reading, those in read.items()}
    fits = [reading for reading in READINGS if seeing[reading] >= SEEING * len(cameras)]
    own, expected = READINGS[0], "poses whose optical axes meet in front of the cameras, in their images"
    found = "; ".join(f"read {r.name}: in those of {seeing[r]} of {len(cameras)}" for r in READINGS[:2])
    how = f"{seeing[own]} see the place where their axes meet"
    if len(fits) != 1 and (places := moving()) is not None:
        angles = {reading: _angle(read[reading], places) for reading in fits or READINGS}
        expected, found = "poses by which the cameras see what moves at one place", _missed(angles)
        best, second = sorted(angles, key=angles.__getitem__)[:2]
        if angles[best] <= LARGEST_ANGLE and angles[best] <= DECISIVE * angles[second]:
            fits, how = [best], f"the rays to what moves meet within {angles[best]:.1f}°"
    if not fits and rig.says_direction and _parallel(list(cameras.values())):
        log(f"{rig.kind}: {len(cameras)} cameras, {own.name} as the format says; their axes are parallel, {found}")
        return read[own]
    if own in fits and (rig.says_direction or len(fits) == 1):
        log(f"{rig.kind}: {len(cameras)} cameras, {own.name}; {how}")
        return read[own]
    if len(fits) == 1 and not rig.says_direction:
        log(f"{rig.kind}: {len(cameras)} cameras, taken as {fits[0].name}: {found}")
        return read[fits[0]]
    if fits and own not in fits:
        found += f"; as {' or '.join(r.name for r in fits)} they do: invert or turn the poses in the file"
    elif fits:
        found += "; the file does not tell which: keys world_to_cam or cam_to_world (3 x 4) do"
    raise SceneError(where, expected, found)


def _angle(cameras: Mapping[str, Camera], places: Places) -> float:
    """Degrees, see meeting_angle; inf where too little moves."""
    small = {name: camera.resized(*small_size(camera)) for name, camera in cameras.items()}
    angle = meeting_angle(small, places)
    return float("inf") if angle is None else angle


def _missed(angles: Mapping[Reading, float]) -> str:
    """`read world-to-camera: rays that miss each other by 5.9°; …`"""
    return "; ".join(
        f"read {reading.name}: {'nothing that they see' if np.isinf(a) else f'rays that miss each other by {a:.1f}°'}"
        for reading, a in angles.items()
    )


def seen_by(cameras: list[Camera]) -> int:
    """How many cameras have the place nearest to all optical axes in their image; 0 where the axes are parallel."""
    positions = np.stack([camera.position for camera in cameras])
    middle = positions.mean(axis=0)
    place = intersect_axes(positions - middle, np.stack([camera.world_to_cam[2, :3] for camera in cameras]))
    if place is None:
        return 0
    return sum(bool(in_image(*project((place + middle)[None], camera), camera)[0]) for camera in cameras)


def _parallel(cameras: list[Camera]) -> bool:
    axes = np.stack([camera.world_to_cam[2, :3] for camera in cameras])
    return bool((axes @ axes.mean(axis=0) > np.cos(np.radians(PARALLEL))).all())


def _refuse_twins(cameras: Mapping[str, Camera], where: str) -> None:
    names, positions = list(cameras), np.stack([camera.position for camera in cameras.values()])
    size = float(np.ptp(positions, axis=0).max())
    for i, name in enumerate(names):
        for j in range(i):
            if np.linalg.norm(positions[i] - positions[j]) <= SAME_PLACE * size:
                raise SceneError(where, "a place of its own for each camera", f"{names[j]} and {name} at the same")
