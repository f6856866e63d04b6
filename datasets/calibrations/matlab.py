"""MATLAB .mat: structs with intrinsics as MATLAB has them, transposed, and pixels counted from 1.

    params, camnames                     DANNCE's and Label3D's files: {K, RDistort, TDistort, r, t} for each camera
    CameraParameters1, …2, RotationOfCamera2, TranslationOfCamera2     toStruct(stereoParams), at any depth
    IntrinsicMatrix or K, RadialDistortion, TangentialDistortion, ImageSize     toStruct(cameraParams)

Rows multiply from the left: x_cam = X r + t. Objects that were saved without toStruct cannot be read outside of MATLAB.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import scipy.io

from datasets.calibrations.rig import MATLAB_CENTRE, Rig, RigCamera, as_size, intrinsics_of, lens_of, numbers, pose_of
from datasets.files.errors import SceneError

KNOWN = "params (DANNCE), or toStruct(stereoParams)"


def read(path: Path) -> Rig:
    try:
        content = {k: v for k, v in scipy.io.loadmat(path, simplify_cells=True).items() if not k.startswith("__")}
    except NotImplementedError:  # what scipy raises for version 7.3, which is HDF5
        raise SceneError(path, "a .mat of version 7 or older", "version 7.3; save(FILE, '-v7') writes it") from None
    except Exception as error:  # scipy raises many types for broken files
        raise SceneError(path, "a .mat file", str(error)) from None
    if "params" in content:
        return _labelled(content, path)
    for key, value in content.items():
        if isinstance(value, dict) and "CameraParameters1" in value:
            return _stereo(value, f"{path}: {key}")
    if "CameraParameters1" in content:
        return _stereo(content, str(path))
    objects = [key for key, value in content.items() if isinstance(value, np.ndarray) and value.dtype == object]
    found = ", ".join(content) or "nothing"
    raise SceneError(path, KNOWN, f"{found}{' (objects: save toStruct(…) of them)' if objects else ''}")


def _labelled(content: dict[str, Any], path: Path) -> Rig:
    listed = content["params"]
    cameras = [listed] if isinstance(listed, dict) else list(np.ravel(np.asarray(listed, dtype=object)))
    names = [str(name) for name in np.ravel(content.get("camnames", []))]
    if names and len(names) != len(cameras):
        raise SceneError(f"{path}: camnames", f"{len(cameras)} names, as params has cameras", f"{len(names)}")
    rig = []
    for index, values in enumerate(cameras):
        where = f"{path}: params {index + 1}"
        if not isinstance(values, dict) or not {"K", "r", "t"} <= set(values):
            raise SceneError(where, "a struct of K, RDistort, TDistort, r, t", type(values).__name__)
        bent = _bent(values.get("RDistort", []), values.get("TDistort", []), where)
        pose = pose_of(numbers(values["r"], (3, 3), f"{where}: r").T, values["t"], where)
        intrinsics = intrinsics_of(values["K"], MATLAB_CENTRE, f"{where}: K")
        rig.append(RigCamera(names[index] if names else str(index + 1), None, intrinsics, bent, pose, where))
    return Rig("MATLAB", tuple(rig))


def _stereo(values: dict[str, Any], where: str) -> Rig:
    """The second camera's pose is relative to the first one's, which is the world's."""
    if "PoseCamera2" in values or not {"RotationOfCamera2", "TranslationOfCamera2"} <= set(values):
        expected = "RotationOfCamera2 and TranslationOfCamera2, as toStruct(stereoParams) has them"
        raise SceneError(where, expected, ", ".join(values))
    turned = numbers(values["RotationOfCamera2"], (3, 3), f"{where}: RotationOfCamera2").T
    poses = np.eye(4), pose_of(turned, values["TranslationOfCamera2"], where)
    cameras = []
    for number, pose in enumerate(poses, 1):
        key = f"{where}: CameraParameters{number}"
        one = values.get(f"CameraParameters{number}")
        if not isinstance(one, dict) or not {"K", "IntrinsicMatrix"} & set(one):
            raise SceneError(key, "a struct with IntrinsicMatrix or K", type(one).__name__)
        shape = numbers(one.get("ImageSize", []), None, f"{key}: ImageSize")  # height, width
        size = as_size(shape[::-1].tolist(), f"{key}: ImageSize") if shape.size == 2 else None
        bent = _bent(one.get("RadialDistortion", []), one.get("TangentialDistortion", []), key)
        matrix = intrinsics_of(one.get("K", one.get("IntrinsicMatrix")), MATLAB_CENTRE, key)
        cameras.append(RigCamera(str(number), size, matrix, bent, pose, key))
    return Rig("MATLAB", tuple(cameras))


def _bent(radial: Any, tangential: Any, where: str) -> tuple[float, ...]:
    """MATLAB's k1, k2[, k3] and p1, p2, which are OpenCV's."""
    k = [*numbers(radial, None, f"{where}: radial distortion"), 0.0, 0.0, 0.0][:3]
    p = [*numbers(tangential, None, f"{where}: tangential distortion"), 0.0, 0.0][:2]
    return lens_of([k[0], k[1], p[0], p[1], k[2]], where)
