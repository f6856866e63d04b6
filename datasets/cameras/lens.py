"""Lens undistortion with OpenCV: the image that a pinhole camera of the same intrinsics would have taken."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np

from rasterizer.camera import Camera


@dataclass(frozen=True)
class Lens(ABC):
    """A distorted lens. The undistorted image has the same size, focal lengths and principal point."""

    fx: float  # pixels; pixel centres lie at integer + 0.5, as in Camera
    fy: float
    cx: float
    cy: float
    coefficients: tuple[float, ...]

    def maps(self, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
        """Source position of each pixel of the undistorted image (width, height), in the format of cv2.remap."""
        # OpenCV's pixel centres lie at integers.
        matrix = np.array([[self.fx, 0, self.cx - 0.5], [0, self.fy, self.cy - 0.5], [0, 0, 1]])
        return self._maps(matrix, np.array(self.coefficients), size)

    @abstractmethod
    def _maps(self, matrix: np.ndarray, bent: np.ndarray, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]: ...

    def scaled_to(self, camera: Camera) -> Lens:
        """The lens in front of an image of another resolution."""
        return replace(self, fx=camera.fx, fy=camera.fy, cx=camera.cx, cy=camera.cy)


class Undistortion(Lens):
    """A lens with OpenCV's coefficients k1, k2, p1, p2, k3[, k4, k5, k6]."""

    @classmethod
    def of(cls, camera: Camera, *coefficients: float) -> Undistortion:
        """The lens of a camera; missing coefficients are 0."""
        return cls(camera.fx, camera.fy, camera.cx, camera.cy, coefficients + (0.0,) * (5 - len(coefficients)))

    def _maps(self, matrix: np.ndarray, bent: np.ndarray, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
        return cv2.initUndistortRectifyMap(matrix, bent, None, matrix, size, cv2.CV_16SC2)


class FisheyeLens(Lens):
    """A fisheye lens, OpenCV's and COLMAP's, with the coefficients k1, k2, k3, k4: the angle θ to the axis is imaged at
    θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸) focal lengths."""

    def _maps(self, matrix: np.ndarray, bent: np.ndarray, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
        return cv2.fisheye.initUndistortRectifyMap(matrix, bent, np.eye(3), matrix, size, cv2.CV_16SC2)


def undistort(image: np.ndarray, maps: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """The undistorted image; maps: Undistortion.maps. Pixels outside the original image repeat its border; `imaged`
    says which."""
    return cv2.remap(image, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


@lru_cache(maxsize=64)  # the frames of a camera share theirs
def imaged(lens: Lens | None, size: tuple[int, int], reduced: tuple[int, int]) -> np.ndarray | None:
    """(h, w) bool: the pixels of the undistorted image, reduced from `size` to `reduced`, that the lens has imaged.

    None: all of them. Sizes are (width, height). A reduced pixel counts if all that it averages do.
    """
    if lens is None:
        return None
    ones = np.ones(size[::-1], np.float32)
    inside = cv2.remap(ones, *lens.maps(size), cv2.INTER_LINEAR) >= 0.5  # by the border's middle: 0 is beyond it
    if inside.all():
        return None
    return cv2.resize(inside.astype(np.float32), reduced, interpolation=cv2.INTER_AREA) >= 1 - 1e-6


def both(a: np.ndarray | None, b: np.ndarray | None) -> np.ndarray | None:
    """The mask of pixels that count in `a` and in `b`; None: all count."""
    return b if a is None else a if b is None else a & b


def undistort_rgba(rgba: np.ndarray, maps: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """`undistort` of (H, W, 4) uint8 with straight alpha, interpolated premultiplied."""
    if rgba[..., 3].min() == 255:
        return np.dstack([undistort(np.ascontiguousarray(rgba[..., :3]), maps), rgba[..., 3]])
    alpha = rgba[..., 3:].astype(np.float32) / 255
    premultiplied = undistort(np.concatenate([rgba[..., :3] * alpha, alpha], axis=-1), maps)
    color = premultiplied[..., :3] / np.maximum(premultiplied[..., 3:], 1e-6)
    return np.rint(np.concatenate([np.minimum(color, 255), 255 * premultiplied[..., 3:]], axis=-1)).astype(np.uint8)
