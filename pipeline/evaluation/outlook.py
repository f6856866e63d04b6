"""What to expect of the model of one clip away from the path of its camera: one sentence, from the path alone.

A single camera sees each moment from one side. How far it went round the scene says from where the model was seen;
how fast, says how many sides of a moving thing were seen before it changed (the angular speed of Gao et al.,
"Monocular Dynamic View Synthesis: A Reality Check", 2022).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from datasets.canonical import intersect_axes
from datasets.scene import Scene

FAST = 30.0  # degrees a second, from which a clip of one camera begins to see a moving thing from several sides
NEAR_PATH = 0.15  # of the path's angle, at least 2°: how far off the path a view may be to look like a held-out one


@dataclass(frozen=True)
class PathAngles:
    """Of the camera's path, seen from the point that it films."""

    spread: float  # degrees between the two farthest positions
    speed: float | None  # degrees a second; None: seconds are not known


def path_angles(scene: Scene, seconds: float | None) -> PathAngles:
    """seconds: that the path took."""
    views = sorted(scene.train, key=lambda view: view.time)
    positions = np.stack([view.camera.position for view in views])
    axes = np.stack([view.camera.world_to_cam[2, :3] for view in views])
    centre = intersect_axes(positions, axes)
    if centre is None:
        centre = positions.mean(axis=0) + 4 * scene.unit * axes.mean(axis=0)
    rays = positions - centre
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    cosines = np.clip(rays @ rays.T, -1, 1)
    steps = np.degrees(np.arccos(np.diagonal(cosines, offset=1)))
    return PathAngles(float(np.degrees(np.arccos(cosines.min()))), float(steps.sum()) / seconds if seconds else None)


def outlook(angles: PathAngles, psnr: float, dynamic: bool) -> str:
    """The sentence. psnr: dB on the held-out frames, which lie on the path."""
    near = max(2.0, NEAR_PATH * angles.spread)
    text = (
        f"what to expect: the camera went {angles.spread:.0f}° around the scene; within about {near:.0f}° of its path "
        f"views look like the held-out frames ({psnr:.1f} dB), farther away they blur, and sides that were never "
        "filmed are missing"
    )
    if dynamic and angles.speed is not None and angles.speed < FAST:
        text += (
            f"; what moves was seen from one side at a time (the camera turned {angles.speed:.0f}° a second), so its "
            "shape is right from there only"
        )
    return text
