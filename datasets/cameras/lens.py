"""Lens undistortion with OpenCV: the image that a pinhole camera of the same intrinsics would have taken."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np

from rasterizer.camera import Camera

ANGLES, RADII = 64, 2048  # at which a lens is tried for a fold


@dataclass(frozen=True)
class Lens(ABC):
    """A distorted lens. The undistorted image has the same size, focal lengths and principal point."""

    fx: float  # pixels; pixel centres lie at integer + 0.5, as in Camera
    fy: float
    cx: float
    cy: float
    coefficients: tuple[float, ...]

    @property
    @abstractmethod
    def names(self) -> tuple[str, ...]:
        """Of the coefficients."""

    @property
    def bends(self) -> bool:
        """Whether it is no pinhole."""
        return any(self.coefficients)

    def maps(self, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
        """Source position of each pixel of the undistorted image (width, height), in the format of cv2.remap."""
        # OpenCV's pixel centres lie at integers.
        matrix = np.array([[self.fx, 0, self.cx - 0.5], [0, self.fy, self.cy - 0.5], [0, 0, 1]])
        return self._maps(matrix, np.array(self.coefficients), size)

    @abstractmethod
    def _maps(self, matrix: np.ndarray, bent: np.ndarray, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]: ...

    @abstractmethod
    def _bent(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where the lens images the directions (x, y, 1), in focal lengths."""

    def fold(self, size: tuple[int, int]) -> np.ndarray:
        """(ANGLES,) distance from the axis, in focal lengths of the undistorted image (width, height), from which on
        the lens images nothing anew: its formula turns back there. Inf: nowhere in the image. At the angles
        2π k / ANGLES from x to y."""
        width, height = size
        farthest = np.hypot(max(self.cx, width - self.cx) / self.fx, max(self.cy, height - self.cy) / self.fy)
        angle = 2 * np.pi * np.arange(ANGLES)[:, None] / ANGLES
        radius = farthest * np.linspace(0, 1, RADII)
        with np.errstate(all="ignore"):
            x, y = self._bent(radius * np.cos(angle), radius * np.sin(angle))
            outwards = np.diff(x * np.cos(angle) + y * np.sin(angle), axis=1) > 0
        return np.where(outwards.all(axis=1), np.inf, radius[outwards.argmin(axis=1)])

    def scaled_to(self, camera: Camera) -> Lens:
        """The lens in front of an image of another resolution."""
        return replace(self, fx=camera.fx, fy=camera.fy, cx=camera.cx, cy=camera.cy)


class Undistortion(Lens):
    """A lens with OpenCV's coefficients k1, k2, p1, p2, k3[, k4, k5, k6]."""

    names = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")

    @classmethod
    def of(cls, camera: Camera, *coefficients: float) -> Undistortion:
        """The lens of a camera; missing coefficients are 0."""
        return cls(camera.fx, camera.fy, camera.cx, camera.cy, coefficients + (0.0,) * (5 - len(coefficients)))

    def _maps(self, matrix: np.ndarray, bent: np.ndarray, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
        return cv2.initUndistortRectifyMap(matrix, bent, None, matrix, size, cv2.CV_16SC2)

    def _bent(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        k1, k2, p1, p2, k3, k4, k5, k6 = (*self.coefficients, 0.0, 0.0, 0.0)[:8]
        r2 = x**2 + y**2
        radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
        return (x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2), y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y)


class FisheyeLens(Lens):
    """A fisheye lens, OpenCV's and COLMAP's, with the coefficients k1, k2, k3, k4: the angle θ to the axis is imaged at
    θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸) focal lengths."""

    names = ("k1", "k2", "k3", "k4")
    bends = True  # also with coefficients of 0

    def _maps(self, matrix: np.ndarray, bent: np.ndarray, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
        return cv2.fisheye.initUndistortRectifyMap(matrix, bent, np.eye(3), matrix, size, cv2.CV_16SC2)

    def _bent(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        k1, k2, k3, k4 = self.coefficients
        radius = np.maximum(np.hypot(x, y), 1e-12)
        angle = np.arctan(radius)
        a2 = angle**2
        scale = angle * (1 + a2 * (k1 + a2 * (k2 + a2 * (k3 + a2 * k4)))) / radius
        return x * scale, y * scale


def undistort(image: np.ndarray, maps: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """The undistorted image; maps: Undistortion.maps. Pixels outside the original image repeat its border; `imaged`
    says which."""
    return cv2.remap(image, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


@lru_cache(maxsize=64)  # the frames of a camera share theirs
def imaged(lens: Lens | None, size: tuple[int, int], reduced: tuple[int, int]) -> np.ndarray | None:
    """(h, w) bool: the pixels of the undistorted image, reduced from `size` to `reduced`, that the lens has imaged.

    None: all of them. Beyond a fold the lens shows its middle again, which does not count. Sizes are (width, height). A
    reduced pixel counts if all that it averages do.
    """
    if lens is None:
        return None
    ones = np.ones(size[::-1], np.float32)
    inside = cv2.remap(ones, *lens.maps(size), cv2.INTER_LINEAR) >= 0.5  # by the border's middle: 0 is beyond it
    if np.isfinite(fold := lens.fold(size)).any():
        column, row = np.meshgrid(np.arange(size[0]) + 0.5, np.arange(size[1]) + 0.5)
        x, y = (column - lens.cx) / lens.fx, (row - lens.cy) / lens.fy
        nearest = np.rint(np.arctan2(y, x) * ANGLES / (2 * np.pi)).astype(int) % ANGLES
        inside &= np.hypot(x, y) < fold[nearest]
    if inside.all():
        return None
    return cv2.resize(inside.astype(np.float32), reduced, interpolation=cv2.INTER_AREA) >= 1 - 1e-6


def fold_line(lens: Lens, size: tuple[int, int]) -> str | None:
    """The line of a log on a lens that folds inside its image (width, height); None: it does not."""
    fold = lens.fold(size)
    counts = imaged(lens, size, size) if np.isfinite(fold).any() else None
    if counts is None:
        return None
    bent = ", ".join(f"{name} {value:g}" for name, value in zip(lens.names, lens.coefficients) if value)
    return (
        f"lens ({bent}): its formula turns back inside the image, {fold.min():.3g} focal lengths from the axis; what "
        f"lies beyond does not count ({100 * (1 - counts.mean()):.0f} % of the pixels)"
    )


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
