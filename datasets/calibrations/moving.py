"""Where something moves in the images of cameras that stand still, and how well the rays to it meet.

Of each camera a few frames, small and undistorted; its background is their median. The middle of what differs from it
is a point that all cameras see at about one place, whatever their distance from each other.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import cv2
import numpy as np

from datasets.cameras.lens import Lens, undistort
from rasterizer.camera import Camera

SIDE = 320  # pixels of the longer side of the small images
FRAMES = 24  # evenly spread
NOISE = 6.0  # × the median difference from the background: what differs by more moves
LEAST = 8.0  # of 255, the same of noiseless images
LEAST_AREA, MOST_AREA = 2e-4, 0.25  # of the image: less is noise, more a change of the light
FEWEST_TIMES = 6  # at which two cameras or more see something move


def small_frames(images: Sequence[np.ndarray], camera: Camera, lens: Lens | None) -> np.ndarray:
    """(T, h, w) float32 grey of frames (H, W, 3), undistorted, at most SIDE pixels; camera: of the full size."""
    size = small_size(camera)
    small = [
        cv2.resize(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), size, interpolation=cv2.INTER_AREA) for image in images
    ]
    if lens is not None:
        maps = lens.scaled_to(camera.resized(*size)).maps(size)
        small = [undistort(image, maps) for image in small]
    return np.stack(small).astype(np.float32)


def small_size(camera: Camera) -> tuple[int, int]:
    scale = min(1.0, SIDE / max(camera.width, camera.height))
    return max(1, round(camera.width * scale)), max(1, round(camera.height * scale))


def middles(frames: np.ndarray) -> np.ndarray:
    """(T, 2) column and row of the middle of the largest moving part of frames (T, h, w), pixels; NaN: none."""
    difference = np.abs(frames - np.median(frames, axis=0))
    bound = max(LEAST, NOISE * float(np.median(difference)))
    found = np.full((len(frames), 2), np.nan)
    for time, moves in enumerate(difference > bound):
        opened = cv2.morphologyEx(moves.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
        count, _, statistics, centroids = cv2.connectedComponentsWithStats(opened)
        if count > 1:
            largest = 1 + int(np.argmax(statistics[1:, cv2.CC_STAT_AREA]))
            if LEAST_AREA <= statistics[largest, cv2.CC_STAT_AREA] / opened.size <= MOST_AREA:
                found[time] = centroids[largest] + 0.5
    return found


def meeting_angle(cameras: Mapping[str, Camera], places: Mapping[str, np.ndarray]) -> float | None:
    """By how many degrees the rays to what moves miss the place nearest to them, median over times and cameras.

    cameras: of the small images. places: name -> `middles`. Inf where most of these places are behind a camera; None
    where too little moves.
    """
    angles: list[float] = []
    behind = times = 0
    for time in range(len(next(iter(places.values())))):
        seeing = [name for name in cameras if np.isfinite(places[name][time]).all()]
        if len(seeing) < 2:
            continue
        times += 1
        positions = np.stack([cameras[name].position for name in seeing])
        rays = np.stack([_ray(cameras[name], places[name][time]) for name in seeing])
        across = np.eye(3) - rays[:, :, None] * rays[:, None, :]
        place = np.linalg.lstsq(across.sum(axis=0), np.einsum("nij,nj->i", across, positions), rcond=None)[0]
        towards = place - positions
        along = np.einsum("ni,ni->n", towards, rays)
        behind += bool((along <= 0).any())
        length = np.linalg.norm(towards, axis=1)
        angles += np.degrees(np.arccos(np.clip(along / np.maximum(length, 1e-12), -1, 1))).tolist()
    if times < FEWEST_TIMES:
        return None
    return float("inf") if behind > times / 2 else float(np.median(angles))


def _ray(camera: Camera, pixel: np.ndarray) -> np.ndarray:
    """(3,) unit vector in the world."""
    x, y = (pixel[0] - camera.cx) / camera.fx, (pixel[1] - camera.cy) / camera.fy
    ray = camera.world_to_cam[:3, :3].T @ np.array([x, y, 1.0])
    return ray / np.linalg.norm(ray)
