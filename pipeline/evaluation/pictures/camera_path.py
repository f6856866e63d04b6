"""Camera path of a bullet-time video: an ellipse among the training cameras, looking at one point.

The path has two turns: the first at the middle of the scene's time, the second while time runs through all of it.
Camera axes are COLMAP's: x right, y down, z forward.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from datasets.canonical import SMALLEST_MEAN_DIRECTION, intersect_axes
from datasets.outliers import inliers
from datasets.urban.projection import in_image, project
from rasterizer import Camera

SECONDS = 5.0  # of video, both turns
FRAME_RATE = 30.0  # frames per second

# Half axes of the ellipse: this quantile of the cameras' distances from the centre along each axis. Between cameras the
# model interpolates, outside of them it extrapolates.
SPREAD_QUANTILE = 0.7


@dataclass(frozen=True)
class PathFrame:
    camera: Camera
    time: float  # in the scene's unit


@dataclass(frozen=True)
class Ellipse:
    """Positions centre + cos θ · first + sin θ · second, looking at `focus` with `down` downwards; world units."""

    centre: np.ndarray  # (3,)
    first: np.ndarray  # (3,) half axis
    second: np.ndarray  # (3,) half axis
    focus: np.ndarray  # (3,)
    down: np.ndarray  # (3,) unit

    def pose(self, angle: float) -> np.ndarray:
        """(4, 4) world_to_cam. angle: θ in radians."""
        position = self.centre + np.cos(angle) * self.first + np.sin(angle) * self.second
        return look_at(position, self.focus, self.down)


def bullet_time(ellipse: Ellipse, intrinsics: Camera, time_start: float, duration: float) -> list[PathFrame]:
    """SECONDS × FRAME_RATE frames with the size and intrinsics of `intrinsics`, on a closed path.

    In the second turn time runs from the middle to the end, then from the start to the middle.
    """
    turn = round(SECONDS * FRAME_RATE / 2)
    frames = []
    for i in range(2 * turn):
        elapsed = 0.5 if i < turn else (0.5 + (i - turn) / turn) % 1.0
        camera = replace(intrinsics, world_to_cam=ellipse.pose(2.0 * np.pi * i / turn))
        frames.append(PathFrame(camera, time_start + elapsed * duration))
    return frames


def ellipse_among(cameras: Sequence[Camera], default_depth: float) -> Ellipse:
    """The ellipse of the path, in the plane of the mean camera's x and y axes.

    Cameras all around the scene have no mean direction; there the plane is that of their two main principal axes.
    default_depth: world units; distance of the focus in front of the mean camera where optical axes do not intersect.
    """
    poses = np.unique(
        np.stack([camera.world_to_cam for camera in cameras]), axis=0
    )  # each camera once, not once per frame
    positions = -np.einsum("nji,nj->ni", poses[:, :3, :3], poses[:, :3, 3])
    kept = inliers(positions)
    poses, positions = poses[kept], positions[kept]
    centre = positions.mean(axis=0)
    forward, down = poses[:, 2, :3].mean(axis=0), _unit(poses[:, 1, :3].mean(axis=0))
    if np.linalg.norm(forward) > SMALLEST_MEAN_DIRECTION:
        right = _unit(np.cross(down, forward))
        plane = right, np.cross(_unit(forward), right)
    else:
        forward = poses[0, 2, :3]
        plane = tuple(np.linalg.svd(positions - centre)[2][:2])
    half = [np.quantile(np.abs((positions - centre) @ axis), SPREAD_QUANTILE) for axis in plane]
    focus = intersect_axes(positions, poses[:, 2, :3])
    if focus is None:
        focus = centre + default_depth * _unit(forward)
    return Ellipse(centre, half[0] * plane[0], half[1] * plane[1], focus, down)


def median_depth(points: np.ndarray, camera: Camera) -> float | None:
    """Median depth z, world units, of the points (N, 3) inside the camera's image; None if there are none."""
    column, row, depth = project(points, camera)
    visible = in_image(column, row, depth, camera)
    return float(np.median(depth[visible])) if visible.any() else None


def look_at(position: np.ndarray, target: np.ndarray, down: np.ndarray) -> np.ndarray:
    """(4, 4) world_to_cam of a camera at `position` that looks at `target` with `down` downwards; world coordinates."""
    forward = _unit(target - position)
    right = _unit(np.cross(down, forward))
    rotation = np.stack([right, np.cross(forward, right), forward])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, -rotation @ position
    return pose


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector)
