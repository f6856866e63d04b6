"""Qualisys Track Manager's text, NAME.qca.txt: XML with intrinsics in 64ths of a pixel and poses in millimetres.

A transform's r11 … r33 and x, y, z turn camera coordinates to the world's, row by row in the order r11 r21 r31; the
camera looks along -z with y up. Only video cameras are read. Lens distortion is OpenCV's, not in 64ths.
"""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from datasets.calibrations.rig import OPENCV_CENTRE, Rig, RigCamera, as_size, intrinsics_of, lens_of, numbers, pose_of
from datasets.files.errors import SceneError

SUBPIXELS = 64.0
MILLIMETRE = 1e-3  # metres
VIDEO_MODELS = ("video", "hybrid", "none")  # parts of the model's name; others film markers only
TO_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])


def read(path: Path) -> Rig:
    try:
        root = ElementTree.parse(path).getroot()
    except (OSError, ElementTree.ParseError, ValueError) as error:
        raise SceneError(path, "Qualisys' XML (.qca.txt)", str(error)) from None
    found = root.findall("cameras/camera")
    films = [camera for camera in found if _is_video(camera)]
    if not films:
        raise SceneError(path, "cameras/camera of a video model", f"{len(found)} others")
    cut = len(found) - len(films)
    notes = (f"{path.name}: {cut} cameras that film markers only are left out",) if cut else ()
    return Rig("Qualisys", tuple(_camera(camera, path) for camera in films), notes=notes)


def _is_video(camera: ElementTree.Element) -> bool:
    model = camera.get("model", "").lower()
    return any(part in model for part in VIDEO_MODELS)


def _camera(camera: ElementTree.Element, path: Path) -> RigCamera:
    name = camera.get("serial", "")
    where = f"{path}: camera {name}"

    def values(tag: str, *keys: str) -> np.ndarray:
        element = camera.find(tag)
        if element is None:
            raise SceneError(where, f"the element {tag}", "none")
        return numbers([element.get(key) for key in keys], (len(keys),), f"{where}: {tag}")

    left, top, right, bottom = values("fov_video", "left", "top", "right", "bottom")
    fx, fy, cx, cy = values("intrinsic", "focalLengthU", "focalLengthV", "centerPointU", "centerPointV") / SUBPIXELS
    k1, k2, p1, p2 = values(
        "intrinsic", "radialDistortion1", "radialDistortion2", "tangentalDistortion1", "tangentalDistortion2"
    )
    turned = values("transform", *(f"r{row}{column}" for row in "123" for column in "123")).reshape(3, 3)
    position = values("transform", "x", "y", "z") * MILLIMETRE
    # The file's r11 r12 r13 is a column of camera-to-world.
    cam_to_world = pose_of(turned.T, position, where)
    return RigCamera(
        name,
        as_size([right - left + 1, bottom - top + 1], f"{where}: fov_video"),
        intrinsics_of([[fx, 0, cx - left], [0, fy, cy - top], [0, 0, 1]], OPENCV_CENTRE, f"{where}: intrinsic"),
        lens_of([k1, k2, p1, p2], f"{where}: intrinsic"),
        TO_OPENCV @ np.linalg.inv(cam_to_world),
        where,
    )
