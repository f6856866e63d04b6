"""`Rig`: what a calibration file says of several cameras, and checked access to its numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from datasets.cameras.intrinsics import LARGEST_COEFFICIENT
from datasets.cameras.lens import FisheyeLens, Lens, Undistortion
from datasets.files.errors import SceneError
from datasets.scene import make_camera
from rasterizer.camera import Camera

OPENCV_CENTRE, MATLAB_CENTRE = 0.5, -0.5  # added to a principal point: first pixels are centred at 0 and at 1 there
SHAPE_TOLERANCE = 1.0  # pixels by which a size at another scale may be rounded
LARGEST_SKEW = 0.01  # of the focal length: more is no real sensor


@dataclass(frozen=True)
class RigCamera:
    """A camera of a calibration file."""

    name: str
    size: tuple[int, int] | None  # (width, height) of the calibration's images, pixels; None: the file does not say
    intrinsics: tuple[float, float, float, float]  # fx, fy, cx, cy, pixels as in Camera
    bent: tuple[float, ...]  # distortion: OpenCV's coefficients, those of its fisheye model if `fisheye`
    pose: np.ndarray  # (4, 4) world-to-camera, COLMAP's axes, as the format has it
    where: str  # file and key, for messages
    fisheye: bool = False

    def of(self, size: tuple[int, int], pixels: str) -> tuple[Camera, Lens | None]:
        """Camera and lens (None: no distortion) of images (width, height), which may be scaled.

        pixels: what has that size, for messages. SceneError for another shape and invalid numbers.
        """
        width, height = self.size or size
        scale = max(size[0] / width, size[1] / height)
        if max(abs(size[0] - scale * width), abs(size[1] - scale * height)) > SHAPE_TOLERANCE:
            expected = f"{size[0]} x {size[1]} pixels as {pixels}, or that shape at another scale"
            raise SceneError(self.where, expected, f"{width} x {height}")
        fx, fy, cx, cy = (scale * value for value in self.intrinsics)
        camera = make_camera(self.where, lambda: Camera(*size, fx, fy, cx, cy, self.pose))
        if not all(abs(value) <= LARGEST_COEFFICIENT for value in self.bent):
            raise SceneError(self.where, f"a lens distortion within ±{LARGEST_COEFFICIENT:g}", f"{self.bent}")
        if self.fisheye:
            return camera, FisheyeLens(fx, fy, cx, cy, self.bent + (0.0,) * (4 - len(self.bent)))
        return camera, Undistortion.of(camera, *self.bent) if any(self.bent) else None


@dataclass(frozen=True)
class Rig:
    """All cameras of a calibration file."""

    kind: str  # of the format, for messages
    cameras: tuple[RigCamera, ...]
    says_direction: bool = True  # whether the format defines poses as world-to-camera, so that `pose` is no guess
    notes: tuple[str, ...] = ()  # lines for the log


def numbers(value: Any, shape: tuple[int, ...] | None, where: str) -> np.ndarray:
    """`value` as finite float64 of `shape` (None: any, flattened); SceneError otherwise."""
    try:
        found = np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        found = np.full(1, np.nan)
    fits = shape is None or found.size == np.prod(shape)
    if not fits or not np.isfinite(found).all():
        expected = "finite numbers" if shape is None else f"{' x '.join(map(str, shape))} finite numbers"
        raise SceneError(where, expected, f"{found.size} numbers" if not fits else "others")
    return found.ravel() if shape is None else found.reshape(shape)


def intrinsics_of(matrix: Any, centre: float, where: str) -> tuple[float, float, float, float]:
    """fx, fy, cx, cy of a 3 x 3 matrix, either way round: its last row or its last column is 0 0 1.

    centre: OPENCV_CENTRE or MATLAB_CENTRE. A skew that is not small is refused, a small one left out.
    """
    k = numbers(matrix, (3, 3), where)
    if not np.array_equal(k[2] / (k[2, 2] or 1.0), [0, 0, 1]):
        k = k.T  # as MATLAB writes it
    if not (np.array_equal(k[2] / (k[2, 2] or 1.0), [0, 0, 1]) and k[1, 0] == 0 and k[0, 0] > 0 and k[1, 1] > 0):
        raise SceneError(where, "a matrix of intrinsics, fx 0 cx / 0 fy cy / 0 0 1 or transposed", f"{k.tolist()}")
    k = k / k[2, 2]
    if abs(k[0, 1]) > LARGEST_SKEW * k[0, 0]:
        raise SceneError(where, "pixels without skew", f"{k[0, 1]:g} beside a focal length of {k[0, 0]:g}")
    return float(k[0, 0]), float(k[1, 1]), float(k[0, 2]) + centre, float(k[1, 2]) + centre


def pose_of(rotation: Any, translation: Any, where: str) -> np.ndarray:
    """(4, 4) of a rotation, as 3 x 3 or as Rodrigues' vector, and a translation."""
    turned = numbers(rotation, None, f"{where}: rotation")
    if turned.size not in (3, 9):
        raise SceneError(f"{where}: rotation", "3 numbers (Rodrigues) or 3 x 3", f"{turned.size}")
    pose = np.eye(4)
    pose[:3, :3] = cv2.Rodrigues(turned)[0] if turned.size == 3 else turned.reshape(3, 3)
    pose[:3, 3] = numbers(translation, (3,), f"{where}: translation")
    return pose


def lens_of(values: Any, where: str) -> tuple[float, ...]:
    """OpenCV's coefficients; SceneError for more than its rational model has, as of tilted sensors."""
    found = numbers(values, None, where)
    if found.size > 8 and found[8:].any():
        raise SceneError(where, "at most 8 coefficients (k1, k2, p1, p2, k3 to k6)", f"{found.size}")
    return tuple(found[:8].tolist())


def as_size(values: Sequence[Any], where: str) -> tuple[int, int]:
    """(width, height) in whole pixels."""
    width, height = numbers(values, (2,), where)
    if not (width >= 1 and height >= 1):
        raise SceneError(where, "a width and a height in pixels", f"{width:g} x {height:g}")
    return round(width), round(height)
