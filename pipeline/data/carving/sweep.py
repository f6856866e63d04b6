"""Depth of the still background by a sweep: of each pixel the depth at which other cameras see the same texture.

Texture is compared in windows, without their mean and contrast, so that gain, exposure and a lamp to one side do not
count. A depth is kept where another camera's own sweep puts its surface at the same place.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import cv2
import numpy as np

from rasterizer.camera import Camera

WINDOW = 7  # pixels
STEPS = 128  # depths, evenly spaced in inverse depth
LEAST_TEXTURE = 4.0  # of 255: standard deviation in a window; flatter ones match everywhere
LEAST_MATCH = 0.5  # correlation, mean of the best BEST cameras
BEST = 2
SAME_DEPTH = 0.02  # relative difference of two cameras' depths of one place


def depths(
    images: Sequence[np.ndarray], cameras: Sequence[Camera], ranges: Sequence[tuple[float, float]]
) -> list[np.ndarray]:
    """Of each camera (h, w) float32 depth z in world units, 0 where none is found.

    images: (h, w) float32 grey of the background. ranges: of each camera the nearest and the farthest depth.
    """
    swept = [_swept(i, images, cameras, *near_far) for i, near_far in enumerate(ranges)]
    return [_agreed(i, swept, cameras) for i in range(len(cameras))]


def _swept(i: int, images: Sequence[np.ndarray], cameras: Sequence[Camera], near: float, far: float) -> np.ndarray:
    """(h, w) depth of the best correlation; 0: none good enough."""
    image, camera = images[i], cameras[i]
    best, found = np.full(image.shape, LEAST_MATCH, np.float32), np.zeros(image.shape, np.float32)
    mean, deviation = _moments(image)
    others = [j for j in range(len(cameras)) if j != i]
    lines = [line(camera, cameras[j]) for j in others]
    for depth in _planes(camera, cameras, near, far):
        scores = np.stack(
            [
                _correlation(image, mean, deviation, images[j], slope * depth + start)
                for j, (slope, start) in zip(others, lines)
            ]
        )
        scores.sort(axis=0)
        score = scores[-BEST:].mean(axis=0)  # -1 of a camera that does not see it
        better = score > best
        best[better], found[better] = score[better], depth[better]
    return np.where(deviation > LEAST_TEXTURE, found, 0)


def _planes(camera: Camera, cameras: Sequence[Camera], near: float, far: float) -> Iterator[np.ndarray]:
    """(h, w) depths of planes of a few directions: across the camera's axis, and across the mean of all cameras'."""
    column, row = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    rays = np.stack([(column - camera.cx) / camera.fx, (row - camera.cy) / camera.fy, np.ones_like(column)])
    common = camera.world_to_cam[:3, :3] @ np.mean([c.world_to_cam[2, :3] for c in cameras], axis=0)
    for normal in (np.array([0.0, 0.0, 1.0]), common / np.linalg.norm(common)):
        along = np.einsum("i,ihw->hw", normal, rays)
        for depth in 1 / np.linspace(1 / near, 1 / far, STEPS):
            plane = depth * normal[2] / np.where(along > 0, along, np.inf)  # through that depth on the axis
            yield np.where((plane > near) & (plane < far), plane, far).astype(np.float32)


def line(camera: Camera, other: Camera) -> tuple[np.ndarray, np.ndarray]:
    """(3, h, w) slope and (3, 1, 1) start: slope × depth + start is where `other` sees each pixel of `camera`,
    homogeneous."""
    column, row = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    rays = np.stack([(column - camera.cx) / camera.fx, (row - camera.cy) / camera.fy, np.ones_like(column)])
    between = other.world_to_cam @ np.linalg.inv(camera.world_to_cam)
    matrix = np.array([[other.fx, 0, other.cx], [0, other.fy, other.cy], [0, 0, 1]])
    slope = np.einsum("ij,jhw->ihw", matrix @ between[:3, :3], rays)
    return slope, (matrix @ between[:3, 3])[:, None, None]


def _correlation(
    image: np.ndarray, mean: np.ndarray, deviation: np.ndarray, other: np.ndarray, pixel: np.ndarray
) -> np.ndarray:
    """(h, w) in [-1, 1] of the windows in `image` and where they are in `other`; -1 where that is out of sight."""
    z = pixel[2]
    front = z > 0
    x = np.where(front, pixel[0] / np.where(front, z, 1), -1).astype(np.float32) - 0.5
    y = np.where(front, pixel[1] / np.where(front, z, 1), -1).astype(np.float32) - 0.5
    warped = cv2.remap(other, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    inside = (x > 0) & (y > 0) & (x < other.shape[1] - 1) & (y < other.shape[0] - 1)
    its_mean, its_deviation = _moments(warped)
    product = cv2.blur(image * warped, (WINDOW, WINDOW)) - mean * its_mean
    score = product / np.maximum(deviation * its_deviation, LEAST_TEXTURE**2)
    return np.where(inside, np.clip(score, -1, 1), -1).astype(np.float32)


def _moments(image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    mean = cv2.blur(image, (WINDOW, WINDOW))
    return mean, np.sqrt(np.maximum(cv2.blur(image**2, (WINDOW, WINDOW)) - mean**2, 0))


def _agreed(i: int, swept: Sequence[np.ndarray], cameras: Sequence[Camera]) -> np.ndarray:
    """The depths of camera i that another camera has too."""
    own = swept[i]
    agreed = np.zeros(own.shape, bool)
    for j, theirs in enumerate(swept):
        if j == i:
            continue
        slope, start = line(cameras[i], cameras[j])
        pixel = slope * own + start
        z = np.where(pixel[2] > 0, pixel[2], np.inf)
        column, row = np.floor(pixel[0] / z).astype(int), np.floor(pixel[1] / z).astype(int)
        inside = (own > 0) & (pixel[2] > 0) & (column >= 0) & (row >= 0)
        inside &= (column < theirs.shape[1]) & (row < theirs.shape[0])
        depth = np.where(inside, theirs[np.where(inside, row, 0), np.where(inside, column, 0)], 0)
        agreed |= inside & (np.abs(depth - z) < SAME_DEPTH * z)
    return np.where(agreed, own, 0)
