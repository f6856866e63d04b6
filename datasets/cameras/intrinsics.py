"""Intrinsics of transforms files: instant-ngp's keys, which COLMAP-to-NeRF converters write.

    "fl_x", "fl_y", "cx", "cy"     pixels of an image "w" × "h"; by default of the image file's size
    "camera_angle_x", "…_y"        fields of view in radians, instead of "fl_x", "fl_y"
    "k1", "k2", "p1", "p2", "k3"   OpenCV's lens distortion; "camera_model" is COLMAP's name of the lens model
    "distortion_params"            nerfstudio's list of k1, k2, k3, k4, p1, p2, instead of these keys

Defaults: square pixels, the principal point in the middle, no distortion. Keys of an entry override those of the file.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from datasets.files.errors import SceneError
from datasets.files.json_values import read_number
from datasets.scene import make_camera
from rasterizer.camera import Camera

DISTORTION_KEYS = ("k1", "k2", "p1", "p2", "k3")  # in OpenCV's order
LISTED_KEYS = ("k1", "k2", "k3", "k4", "p1", "p2")  # in the order of distortion_params
# COLMAP's models that OpenCV's formula covers; coefficients of other models have another meaning.
LENS_MODELS = ("PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV")
LARGEST_COEFFICIENT = 1e6  # of distortion; those of real lenses are below 100
SMALLEST_ANGLE = 1e-6  # radians; a telescope's field of view is 1e-3
ANGLE_TOLERANCE = (
    0.01  # relative difference of fl_x and camera_angle_x: converters round, and compute the angle before resizing
)
FOCAL_KEYS = (("fl_x", "camera_angle_x"), ("fl_y", "camera_angle_y"))  # of x and of y


def merge_intrinsics(content: dict, entry: dict, where: str) -> dict[str, Any]:
    """The keys of the file, overridden by those of one entry; distortion_params as the keys LISTED_KEYS.

    A focal length of the entry, in pixels or as an angle, replaces both of the file's keys for that axis. SceneError,
    which names `where`, for distortion_params of another length.
    """
    replaced = {key for keys in FOCAL_KEYS for key in keys if any(key in entry for key in keys)}
    shared = {key: value for key, value in content.items() if key != "frames" and key not in replaced}
    return {**shared, **_listed_distortion(shared, where), **entry, **_listed_distortion(entry, where)}


def _listed_distortion(values: dict, where: str) -> dict[str, Any]:
    """The coefficients in distortion_params by their keys; none without it."""
    if "distortion_params" not in values:
        return {}
    listed = values["distortion_params"]
    if not isinstance(listed, list) or len(listed) != len(LISTED_KEYS):
        found = f"{len(listed)} values" if isinstance(listed, list) else type(listed).__name__
        raise SceneError(f"{where}: distortion_params", f"a list of {', '.join(LISTED_KEYS)}", found)
    return dict(zip(LISTED_KEYS, listed))


def read_pinhole(
    values: dict[str, Any], size: tuple[int, int], cam_to_world: np.ndarray, where: str, file: Path
) -> Camera:
    """The pinhole camera of an undistorted image of `size` (width, height) pixels.

    values: of merge_intrinsics. cam_to_world: (4, 4), Blender axes. where, file: named in messages. Raises SceneError
    for invalid parameters, and for "fl_x" and "camera_angle_x" that contradict each other.
    """
    if "fl_x" not in values and "camera_angle_x" not in values:
        raise SceneError(file, "the key camera_angle_x, or fl_x", f"only {', '.join(values)}")
    if not any(key in values for key in ("fl_x", "fl_y", "cx", "cy", "camera_angle_y")):  # D-NeRF's own files
        focal = _focal_of_angle("camera_angle_x", size[0], values, file)
        return make_camera(where, lambda: Camera.from_blender(*size, focal, cam_to_world))

    width, height = _stated_size(values, size, where)
    fx = _focal("fl_x", "camera_angle_x", width, values, where, file)
    fy = _focal("fl_y", "camera_angle_y", height, values, where, file, default=fx)
    cx = read_number(values.get("cx", width / 2), f"{where}: cx")
    cy = read_number(values.get("cy", height / 2), f"{where}: cy")
    scale_x, scale_y = size[0] / width, size[1] / height
    fx, cx, fy, cy = fx * scale_x, cx * scale_x, fy * scale_y, cy * scale_y
    if not (fx > 0 and fy > 0 and np.isfinite([fx, fy, cx, cy]).all()):
        raise SceneError(where, "finite intrinsics, fl_x and fl_y > 0", f"{fx:g}, {fy:g}, {cx:g}, {cy:g}")
    pose = make_camera(where, lambda: Camera.from_blender(*size, fx, cam_to_world)).world_to_cam
    return make_camera(where, lambda: Camera(*size, fx, fy, cx, cy, pose))


def read_distortion(values: dict[str, Any], where: str) -> tuple[float, ...]:
    """Distortion coefficients in the order of DISTORTION_KEYS, 0 by default; SceneError for another lens model."""
    model = values.get("camera_model", LENS_MODELS[0])
    if model not in LENS_MODELS or values.get("is_fisheye"):
        raise SceneError(
            f"{where}: camera_model", ", ".join(LENS_MODELS), "a fisheye" if model in LENS_MODELS else repr(model)
        )
    if (k4 := read_number(values.get("k4", 0.0), f"{where}: k4")) != 0:
        raise SceneError(
            f"{where}: k4",
            "0: only k1, k2, p1, p2 and k3 are supported; undistort the images first (colmap image_undistorter)",
            f"{k4:g}",
        )
    return tuple(read_number(values.get(key, 0.0), f"{where}: {key}", LARGEST_COEFFICIENT) for key in DISTORTION_KEYS)


def stated_shape(values: dict[str, Any]) -> tuple[float, float] | None:
    """ "w" and "h", where both are positive numbers."""
    width, height = values.get("w"), values.get("h")
    if isinstance(width, (int, float)) and isinstance(height, (int, float)) and min(width, height) > 0:
        return float(width), float(height)
    return None


def _stated_size(values: dict[str, Any], size: tuple[int, int], where: str) -> tuple[float, float]:
    """ "w" and "h", by default `size`; they may be the size of the same image at another scale."""
    width, height = (read_number(values.get(key, pixels), f"{where}: {key}") for key, pixels in zip("wh", size))
    if not (
        width > 0 and height > 0 and abs(width * size[1] / height - size[0]) <= max(1.0, size[1] / height) < math.inf
    ):
        raise SceneError(
            where, "w x h of {} x {} or the same shape at another scale".format(*size), f"{width:g} x {height:g}"
        )
    return width, height


def _focal(
    pixels: str, angle: str, side: float, values: dict[str, Any], where: str, file: Path, default: float | None = None
) -> float:
    """Focal length in pixels of an image `side` pixels wide or high, from either of two keys, which must agree."""
    if pixels not in values:
        return default if default is not None and angle not in values else _focal_of_angle(angle, side, values, file)
    focal = read_number(values[pixels], f"{where}: {pixels}")
    if angle in values and focal > 0:
        other = _focal_of_angle(angle, side, values, file)
        if abs(other - focal) > ANGLE_TOLERANCE * focal:
            raise SceneError(
                f"{where}: {pixels}",
                f"the focal length of {angle}, {other:.6g}; remove the key that is wrong",
                f"{focal:.6g}",
            )
    return focal


def _focal_of_angle(key: str, side: float, values: dict[str, Any], file: Path) -> float:
    angle = read_number(values[key], f"{file}: {key}")
    if not SMALLEST_ANGLE <= angle < math.pi:
        raise SceneError(f"{file}: {key}", f"an angle in (0, π) radians, {SMALLEST_ANGLE:g} at least", f"{angle}")
    return 0.5 * side / math.tan(0.5 * angle)
