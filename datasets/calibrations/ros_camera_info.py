"""ROS's camera_info YAML: a file for each camera of a folder, or several in a folder.

    camera_name, image_width, image_height, camera_matrix, distortion_model, distortion_coefficients,
    rectification_matrix R, projection_matrix P

The world is that of the rectified cameras: x_rectified = R x_cam, P's last column is -f × the camera's place in it.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from datasets.calibrations.rig import OPENCV_CENTRE, Rig, RigCamera, as_size, intrinsics_of, lens_of, numbers
from datasets.calibrations.yaml_values import matrix
from datasets.files.errors import SceneError

KEYS = {"camera_matrix", "distortion_model", "projection_matrix"}
MODELS = {"plumb_bob": False, "rational_polynomial": False, "equidistant": True, "fisheye": True}  # whether fisheye


def is_camera_info(values: Mapping[str, Any]) -> bool:
    return set(values) >= KEYS


def rig(files: Mapping[Path, dict[str, Any]]) -> Rig:
    """The cameras of files of one rig."""
    cameras = tuple(_camera(path, values) for path, values in files.items())
    if len({camera.pose.tobytes() for camera in cameras}) < len(cameras):
        first = next(iter(files))
        raise SceneError(
            first,
            "a place of its own for each camera (the last column of projection_matrix, as of a stereo calibration)",
            "the same pose twice: camera_info of single calibrations has no poses",
        )
    return Rig("ROS camera_info", cameras)


def _camera(path: Path, values: dict[str, Any]) -> RigCamera:
    model = values["distortion_model"]
    if model not in MODELS:
        raise SceneError(f"{path}: distortion_model", ", ".join(MODELS), repr(model))
    projection = numbers(matrix(values["projection_matrix"]), (3, 4), f"{path}: projection_matrix")
    turned = numbers(matrix(values.get("rectification_matrix", np.eye(3))), (3, 3), f"{path}: rectification_matrix")
    shift = np.linalg.solve(projection[:, :3], projection[:, 3])  # x_rectified = X + shift
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turned.T, turned.T @ shift
    size = [values.get("image_width"), values.get("image_height")]
    return RigCamera(
        str(values.get("camera_name") or path.stem),
        as_size(size, f"{path}: image_width, image_height"),
        intrinsics_of(matrix(values["camera_matrix"]), OPENCV_CENTRE, f"{path}: camera_matrix"),
        lens_of(matrix(values.get("distortion_coefficients", [])), f"{path}: distortion_coefficients"),
        pose,
        str(path),
        MODELS[model],
    )
