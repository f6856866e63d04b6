"""Camera poses and times of photographed scenes, on a hemisphere around them.

Either one camera per time, each from another side, as in D-NeRF; or one camera that moves along an arc, as a clip.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

RADIUS = 4.0  # distance to the origin, world units, as D-NeRF's scenes (4.03)
ANGLE_X = 0.6911112070083618  # D-NeRF's horizontal field of view, radians
# Sine of the elevation: uniform between these, hence uniform in area over this part of the upper hemisphere.
LOW, HIGH = 0.15, 0.92
# The R2 sequence (Roberts 2018), quasi-random in the unit square: consecutive times have distant poses.
ARC, ELEVATION, SWAY = 1.4, 0.45, 0.08  # of a clip: azimuth over the whole time, elevation and its sway, radians
ASIDE = 0.26  # azimuth of held-out cameras minus that of the camera at their time, radians
PLASTIC = 1.32471795724474602596
R2_STEPS = np.array([1 / PLASTIC, 1 / PLASTIC**2])


@dataclass(frozen=True)
class TimedPose:
    """One camera pose at one time."""

    time: float  # in [0, 1]
    cam_to_world: np.ndarray  # (4, 4), Blender axes: x right, y up, z backward


def training_poses(count: int, rng: np.random.Generator) -> list[TimedPose]:
    """Times i / (count - 1); each from another position on the upper hemisphere."""
    times = np.arange(count) / max(count - 1, 1)
    return _timed_poses(times, rng)


def held_out_poses(count: int, train_count: int, rng: np.random.Generator) -> list[TimedPose]:
    """Times halfway between neighbouring training times, evenly spaced; other positions."""
    return _timed_poses(_times_between(count, train_count), rng)


def arc_poses(count: int, start: float) -> list[TimedPose]:
    """Times i / (count - 1), along an arc that begins at the azimuth `start`, radians."""
    times = np.arange(count) / max(count - 1, 1)
    return [TimedPose(float(time), _on_arc(time, start)) for time in times]


def poses_beside_camera(count: int, train_count: int, start: float, aside: float = ASIDE) -> list[TimedPose]:
    """Times halfway between neighbouring training times, evenly spaced. Azimuths `aside` radians to the left and to
    the right of the camera's at that time, elevations half as much above and below."""
    offsets = ((aside, 0.0), (-aside, 0.0), (0.0, 0.5 * aside), (0.0, -0.5 * aside))
    times = _times_between(count, train_count)
    return [TimedPose(float(time), _on_arc(time, start, *offsets[i % 4])) for i, time in enumerate(times)]


def _on_arc(time: float, start: float, azimuth_off: float = 0.0, elevation_off: float = 0.0) -> np.ndarray:
    azimuth = start + ARC * time + azimuth_off
    elevation = ELEVATION + SWAY * np.sin(3 * np.pi * time) + elevation_off
    flat = np.cos(elevation)
    return look_at_origin(RADIUS * np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)]))


def _times_between(count: int, train_count: int) -> np.ndarray:
    gaps = train_count - 1
    return (np.floor((np.arange(count) + 0.5) * gaps / count) + 0.5) / gaps


def _timed_poses(times: np.ndarray, rng: np.random.Generator) -> list[TimedPose]:
    places = (rng.random(2) + np.arange(len(times))[:, None] * R2_STEPS) % 1.0
    azimuth = 2 * np.pi * places[:, 0]
    height = LOW + (HIGH - LOW) * places[:, 1]
    flat = np.sqrt(1 - height**2)
    positions = RADIUS * np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), height], axis=-1)
    return [TimedPose(float(time), look_at_origin(position)) for time, position in zip(times, positions)]


def look_at_origin(position: np.ndarray) -> np.ndarray:
    """Camera-to-world (4, 4), Blender axes, of an upright camera at `position` that looks at the origin."""
    backward = position / np.linalg.norm(position)
    right = np.cross([0.0, 0.0, 1.0], backward)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3] = np.stack([right, np.cross(backward, right), backward, position], axis=-1)
    return pose
