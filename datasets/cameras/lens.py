"""Images of a lens with distortion as a pinhole would have taken them. OpenCV does the work."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from rasterizer.camera import Camera


@dataclass(frozen=True)
class Undistortion:
    """A lens to be straightened. The image keeps its size, focal lengths and principal point: those of the Camera."""

    fx: float  # pixels, as all intrinsics here: centres of pixels lie at integer + 0.5
    fy: float
    cx: float
    cy: float
    coefficients: tuple[float, ...]  # OpenCV's: k1, k2, p1, p2, k3[, k4, k5, k6]

    @classmethod
    def of(cls, camera: Camera, *coefficients: float) -> Undistortion:
        """The lens of a camera; coefficients that are left out are 0."""
        return cls(camera.fx, camera.fy, camera.cx, camera.cy, coefficients + (0.0,) * (5 - len(coefficients)))

    def maps(self, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
        """Where each pixel of the straight image (width, height) is taken from, as cv2.remap wants it."""
        # OpenCV's pixel centres lie at integers.
        matrix = np.array([[self.fx, 0, self.cx - 0.5], [0, self.fy, self.cy - 0.5], [0, 0, 1]])
        return cv2.initUndistortRectifyMap(matrix, np.array(self.coefficients), None, matrix, size, cv2.CV_16SC2)


def straighten(image: np.ndarray, maps: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """The image as a pinhole would have taken it; maps: Undistortion.maps.

    Where it then reaches beyond what was seen, the edge goes on: there is no truth to show.
    """
    return cv2.remap(image, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def straighten_rgba(rgba: np.ndarray, maps: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """`straighten` of (H, W, 4) uint8 with straight alpha: colours count by their alpha, as far as they show."""
    if rgba[..., 3].min() == 255:
        return np.dstack([straighten(np.ascontiguousarray(rgba[..., :3]), maps), rgba[..., 3]])
    alpha = rgba[..., 3:].astype(np.float32) / 255
    moved = straighten(np.concatenate([rgba[..., :3] * alpha, alpha], axis=-1), maps)
    color = moved[..., :3] / np.maximum(moved[..., 3:], 1e-6)
    return np.rint(np.concatenate([np.minimum(color, 255), 255 * moved[..., 3:]], axis=-1)).astype(np.uint8)
