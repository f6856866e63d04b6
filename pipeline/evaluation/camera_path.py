"""Where the camera of a bullet-time video goes: an ellipse among the training cameras, looking at one point.

Twice around: once with time standing still in the middle of the scene, once more as time runs on through all of it.
Camera axes are COLMAP's: x right, y down, z forward.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from datasets.cameras.optical_axes import SMALLEST_MEAN_DIRECTION, axes_meet
from rasterizer import Camera

SECONDS = 5.0  # of video, both turns
FRAME_RATE = 30.0  # a second

# The ellipse reaches so far along each axis that this part of the cameras is nearer to the middle: between cameras the
# model has seen the scene from both sides, outside of them it guesses.
SPREAD_QUANTILE = 0.7


@dataclass(frozen=True)
class Shot:
    """One frame of a path."""

    camera: Camera
    time: float  # the scene's unit


@dataclass(frozen=True)
class Ellipse:
    """Positions centre + cos θ · first + sin θ · second, looking at `focus`, `down` below; world units."""

    centre: np.ndarray  # (3,)
    first: np.ndarray  # (3,) half axis
    second: np.ndarray  # (3,) half axis
    focus: np.ndarray  # (3,)
    down: np.ndarray  # (3,) unit

    def pose(self, angle: float) -> np.ndarray:
        """(4, 4) world_to_cam at an angle in radians."""
        position = self.centre + np.cos(angle) * self.first + np.sin(angle) * self.second
        return look_at(position, self.focus, self.down)


def bullet_time(ellipse: Ellipse, lens: Camera, time_start: float, duration: float) -> list[Shot]:
    """SECONDS × FRAME_RATE shots through `lens`, a closed path: after the last the first may follow.

    In the second turn time runs on from the middle to the end, and from the start to the middle.
    """
    turn = round(SECONDS * FRAME_RATE / 2)
    shots = []
    for i in range(2 * turn):
        elapsed = 0.5 if i < turn else (0.5 + (i - turn) / turn) % 1.0
        camera = replace(lens, world_to_cam=ellipse.pose(2.0 * np.pi * i / turn))
        shots.append(Shot(camera, time_start + elapsed * duration))
    return shots


def ellipse_among(cameras: Sequence[Camera], usual_depth: float) -> Ellipse:
    """The path's ellipse among the training cameras, in the plane in which the mean camera sees right and down.

    Cameras all around the scene have no mean camera: there it is the plane they lie in. usual_depth: world units; how
    far before the mean camera the focus is where the cameras' axes do not meet in a point.
    """
    poses = np.unique(np.stack([camera.world_to_cam for camera in cameras]), axis=0)  # each once, not once a frame
    positions = -np.einsum("nji,nj->ni", poses[:, :3, :3], poses[:, :3, 3])
    centre = positions.mean(axis=0)
    forward, down = poses[:, 2, :3].mean(axis=0), _unit(poses[:, 1, :3].mean(axis=0))
    if np.linalg.norm(forward) > SMALLEST_MEAN_DIRECTION:
        right = _unit(np.cross(down, forward))
        plane = right, np.cross(_unit(forward), right)
    else:
        forward = poses[0, 2, :3]
        plane = tuple(np.linalg.svd(positions - centre)[2][:2])
    half = [np.quantile(np.abs((positions - centre) @ axis), SPREAD_QUANTILE) for axis in plane]
    focus = axes_meet(positions, poses[:, 2, :3])
    if focus is None:
        focus = centre + usual_depth * _unit(forward)
    return Ellipse(centre, half[0] * plane[0], half[1] * plane[1], focus, down)


def median_depth(points: np.ndarray, camera: Camera) -> float | None:
    """Median z, world units, of the points (N, 3) that the camera sees; None if it sees none."""
    x, y, z = camera.world_to_cam[:3, :3] @ points.T + camera.world_to_cam[:3, 3:]
    with np.errstate(divide="ignore", invalid="ignore"):
        column, row = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
    seen = (z > 0) & (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
    return float(np.median(z[seen])) if seen.any() else None


def look_at(position: np.ndarray, target: np.ndarray, down: np.ndarray) -> np.ndarray:
    """(4, 4) world_to_cam of a camera at `position` that has `target` in its middle and `down` below."""
    forward = _unit(target - position)
    right = _unit(np.cross(down, forward))
    rotation = np.stack([right, np.cross(forward, right), forward])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, -rotation @ position
    return pose


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector)
