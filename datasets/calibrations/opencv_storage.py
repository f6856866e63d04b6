"""OpenCV's FileStorage YAML, whose keys everybody names as he likes: in one file, or in a file for each camera.

    K_NAME, D_NAME, R_NAME, T_NAME       numbered or named; also in two files, intri.yml and extri.yml (EasyMocap)
    M1, D1, M2, D2 and R, T              a stereo pair (cv2.stereoCalibrate): the first camera is the world
    NAME: {K, D, R, T}                   a mapping for each camera
    K, D, R, T                           one camera, in a folder of such files, called after the file

FIELDS lists the names that are known. Rotations are 3×3 or Rodrigues' vectors. The format does not say whether poses
are world-to-camera; OpenCV's own functions return that.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from datasets.calibrations.rig import OPENCV_CENTRE, Rig, RigCamera, as_size, intrinsics_of, lens_of, numbers, pose_of
from datasets.calibrations.yaml_values import matrix
from datasets.files.errors import SceneError

FIELDS = {
    "matrix": ("camera_matrix", "cameraMatrix", "intrinsic_matrix", "intrinsics", "intrinsic", "mtx", "K", "M"),
    "bent": ("distortion_coefficients", "distortion_coeffs", "dist_coeffs", "distCoeffs", "distortion", "dist", "D"),
    # A matrix before a vector where a file has both.
    "rotation": ("rotation_matrix", "Rot", "rotation", "rvec", "R"),
    "translation": ("translation_vector", "translation", "tvec", "T"),
    "extrinsic": ("extrinsics", "extrinsic"),  # 3 x 4 or 4 x 4
    "to_cam": ("world_to_cam", "w2c"),  # the same, with a direction
    "to_world": ("cam_to_world", "c2w"),
    "width": ("image_width", "image_Width", "width"),
    "height": ("image_height", "image_Height", "height"),
    "size": ("image_size", "imageSize", "size"),
    "model": ("model", "camera_model", "distortion_model", "fisheye"),
}
ALIASES = {alias.lower(): field for field, aliases in FIELDS.items() for alias in aliases}
NAMED = re.compile(rf"({'|'.join(sorted(ALIASES, key=len, reverse=True))})(?:[_-](.+)|(\d+))", re.IGNORECASE)
SHARED = {"rotation", "translation"}  # of a stereo pair
POSED = {"translation", "extrinsic", "to_cam", "to_world"}  # one of them has the pose
ONLY = ""  # the name of what belongs to no named camera


def rig(files: Mapping[Path, dict[str, Any]]) -> Rig:
    """The cameras of the files. SceneError where one lacks intrinsics or pose."""
    cameras: dict[str, dict[str, Any]] = {}
    source: dict[str, Path] = {}
    for path, content in files.items():
        for name, values in _by_name(content).items():
            own = path.stem if name == ONLY and len(files) > 1 else name
            cameras.setdefault(own, {}).update(values)
            source.setdefault(own, path)
    shared = cameras.get(ONLY, {})
    named = {name: values for name, values in cameras.items() if name != ONLY}
    calibrated = sorted(name for name, values in named.items() if "matrix" in values)
    if len(calibrated) == 2 and set(shared) >= SHARED and not any(POSED & set(named[name]) for name in calibrated):
        first, second = calibrated
        pose = pose_of(shared["rotation"], shared["translation"], str(next(iter(files))))
        named = {first: named[first] | {"to_cam": np.eye(4)}, second: named[second] | {"to_cam": pose}}
    for values in named.values():  # one size of all
        for key in ("width", "height", "size"):
            if key in shared:
                values.setdefault(key, shared[key])
    named = {name: values for name, values in named.items() if {"matrix", *POSED} & set(values)}
    if not named:
        known = ", ".join(aliases[-1] for aliases in list(FIELDS.values())[:4])
        found = ", ".join(key for content in files.values() for key in content)
        raise SceneError(next(iter(files)), f"cameras as K_1, D_1, R_1, T_1, … ({known} and their like)", found)
    says = all({"to_cam", "to_world"} & set(values) for values in named.values())
    rig_cameras = tuple(_camera(name, values, f"{source[name]}: camera {name}") for name, values in named.items())
    return Rig("OpenCV", rig_cameras, says_direction=says)


def _by_name(content: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Name of the camera -> its values by field; ONLY: of keys without a name."""
    found: dict[str, dict[str, Any]] = {}
    for key, value in content.items():
        if isinstance(value, dict) and "data" not in value:
            inner = {ALIASES[k.lower()]: matrix(v) for k, v in _preferred(value) if k.lower() in ALIASES}
            found.setdefault(key, {}).update(inner)
    for key, value in _preferred(content):
        if isinstance(value, dict) and "data" not in value:
            continue
        if key.lower() in ALIASES:
            found.setdefault(ONLY, {})[ALIASES[key.lower()]] = matrix(value)
        elif match := NAMED.fullmatch(key):
            found.setdefault(match[2] or match[3], {})[ALIASES[match[1].lower()]] = matrix(value)
    return found


def _preferred(content: dict[str, Any]) -> list[tuple[str, Any]]:
    """The items, the preferred names of a field last, so that they stay."""

    def place(key: str) -> int:
        match = NAMED.fullmatch(key)
        alias = (match[1] if match else key).lower()
        return -list(ALIASES).index(alias) if alias in ALIASES else 0

    return sorted(((str(key), value) for key, value in content.items()), key=lambda item: place(item[0]))


def _camera(name: str, values: dict[str, Any], where: str) -> RigCamera:
    if "matrix" not in values:
        raise SceneError(where, f"intrinsics ({', '.join(FIELDS['matrix'])})", f"only {', '.join(values)}")
    size = values.get("size", [values.get("width"), values.get("height")])
    known = "size" in values or {"width", "height"} <= set(values)
    model = str(values.get("model", "")).lower()
    return RigCamera(
        name,
        as_size(np.ravel(size).tolist(), f"{where}: size") if known else None,
        intrinsics_of(values["matrix"], OPENCV_CENTRE, f"{where}: intrinsics"),
        lens_of(values.get("bent", []), f"{where}: distortion"),
        _pose(values, where),
        where,
        "fisheye" in model or model in ("equidistant", "true", "1"),
    )


def _pose(values: dict[str, Any], where: str) -> np.ndarray:
    for field in ("to_cam", "to_world", "extrinsic"):
        if field in values:
            rows = numbers(values[field], None, f"{where}: extrinsics")
            if rows.size not in (12, 16):
                raise SceneError(f"{where}: extrinsics", "3 x 4 or 4 x 4 numbers", f"{rows.size}")
            turned = rows.reshape(-1, 4)
            pose = pose_of(turned[:3, :3], turned[:3, 3], where)
            return np.linalg.inv(pose) if field == "to_world" else pose
    if set(values) >= SHARED:
        return pose_of(values["rotation"], values["translation"], where)
    found = f"only {', '.join(values)}: a calibration of single cameras has none"
    raise SceneError(where, "a pose (R and T)", found)
