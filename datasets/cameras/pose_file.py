"""Poses and times of one's own: a transforms file without images (datasets/cameras/intrinsics.py has its keys).

    {"camera_angle_x": 0.7, "w": 800, "h": 600, "frames": [{"transform_matrix": [[…], …], "time": 0.5}, …]}

Matrices are camera-to-world with NeRF's axes, as in the transforms files of data sets, which can be given too.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from datasets.cameras.intrinsics import FOCAL_KEYS, merge_intrinsics, read_pinhole
from datasets.cameras.transforms import read_pose, read_time
from datasets.files.errors import SceneError
from datasets.files.json_values import get_key, read_number, read_object
from rasterizer.camera import Camera


def read_poses(file: Path, default: Camera) -> list[tuple[Camera, float | None]]:
    """(camera, time) of each frame, in the coordinates and the unit of the file; None: it has no time.

    default: its size is taken where the file has no "w" and "h", its intrinsics where the file has no focal length.
    Raises SceneError, one line, for what is missing or invalid.
    """
    expected = "an object with a list frames of at least one pose"
    content = read_object(file, expected, "a file of poses, or orbit")
    frames = get_key(content, "frames", file)
    if not isinstance(frames, list) or not frames:
        raise SceneError(file, expected, type(content).__name__)
    return [_read_frame(frame, content, default, f"{file}: frames[{i}]", file) for i, frame in enumerate(frames)]


def _read_frame(frame: Any, content: dict, default: Camera, where: str, file: Path) -> tuple[Camera, float | None]:
    if not isinstance(frame, dict):
        raise SceneError(where, "an object", type(frame).__name__)
    values = merge_intrinsics(content, frame, where)
    pose = read_pose(get_key(frame, "transform_matrix", where), f"{where}: transform_matrix")
    size = tuple(
        round(read_number(values.get(key, side), f"{where}: {key}"))
        for key, side in (("w", default.width), ("h", default.height))
    )
    if min(size) < 1:
        raise SceneError(where, "a size of at least one pixel", "{} x {}".format(*size))
    if any(key in values for keys in FOCAL_KEYS for key in keys):
        camera = read_pinhole(values, (size[0], size[1]), pose, where, file)
    else:
        posed = Camera.from_blender(default.width, default.height, default.fx, pose)
        camera = replace(default, world_to_cam=posed.world_to_cam).resized(size[0], size[1])
    return camera, read_time(frame, where)
