"""`carve`: points from the images of cameras that stand still, where nothing can be triangulated.

What moves is carved at some times by what differs from each camera's background (hull.py). The background, each pixel's
median over time, is swept for depths that cameras agree on (sweep.py). Its other pixels are put on a shell behind all
cameras, where they hide nothing from those that look the other way.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from datasets.scene import Box
from datasets.urban.projection import in_image, project
from pipeline.data.carving.hull import hull
from pipeline.data.carving.sweep import depths
from rasterizer.camera import Camera

# A pixel moves that differs from the background by more: × the usual difference, and of the background's range, which
# is small in the dark.
NOISE, LEAST = 5.0, 0.05
JUDGED_CAMERAS, JUDGED_SHARE = 3, 2e-3  # a time is judged where so many see so much of their image move
NEAR, FAR = 0.3, 2.0  # of the sweep, × the distance of the box's middle
WINDOW, LEAST_SHARE = 15, 0.3  # pixels; share of a window's pixels that have a depth, for its median to count
SAME_SURFACE = 0.08  # relative difference from the median; farther ones are wrong matches
SHELL = 2.5  # radius around the box's middle, × that of the farthest camera
VISIBLE = 1.5  # cells by which a point may be behind the nearest one of its pixel


@dataclass(frozen=True)
class CameraFilm:
    """Images of one camera at the times that all share."""

    camera: Camera
    images: np.ndarray  # (T, h, w, 3) uint8
    silhouettes: np.ndarray | None = None  # (T, h, w) bool, as the data have them; None: by what differs from the rest

    def moving(self, background: np.ndarray) -> np.ndarray:
        """(T, h, w) bool: what is carved."""
        return moving_pixels(self.images, background) if self.silhouettes is None else self.silhouettes


@dataclass(frozen=True)
class Carved:
    """Points with colours, and the times at which they are there."""

    points: np.ndarray  # (N, 3) world units
    colors: np.ndarray  # (N, 3) uint8
    times: np.ndarray  # (N,) place of the time; NaN: at all times
    found: float  # share of the moving pixels that the hulls explain; NaN: too little moves
    swept: float  # share of the background's pixels with a depth

    @property
    def moving(self) -> np.ndarray:
        """(N,) bool."""
        return np.isfinite(self.times)


def carve(films: Sequence[CameraFilm], box: Box) -> Carved:
    """box: where something may move, in the cameras' coordinates."""
    cameras = [film.camera for film in films]
    backgrounds = [np.asarray(np.median(film.images, axis=0), np.uint8) for film in films]
    silhouettes = [film.moving(still) for film, still in zip(films, backgrounds)]
    parts, colors, times, explained = [], [], [], []
    for time in range(len(films[0].images)):
        inside = [of_camera[time] for of_camera in silhouettes]
        points, cell = hull(inside, cameras, box)
        if sum(part.mean() > JUDGED_SHARE for part in inside) >= JUDGED_CAMERAS:
            explained.append(_explained(points, cell, inside, cameras))
        parts.append(points)
        colors.append(colors_of(points, cell, [film.images[time] for film in films], cameras))
        times.append(np.full(len(points), float(time)))
    still, still_colors, swept = np.zeros((0, 3)), np.zeros((0, 3), np.uint8), 0.0
    if any(film.silhouettes is None for film in films):  # else there is nothing around them
        still, still_colors, swept = background_points(backgrounds, cameras, box)
    return Carved(
        np.concatenate([*parts, still]),
        np.concatenate([*colors, still_colors]),
        np.concatenate([*times, np.full(len(still), np.nan)]),
        float(np.mean(explained)) if explained else float("nan"),
        swept,
    )


def moving_pixels(images: np.ndarray, background: np.ndarray) -> np.ndarray:
    """(T, h, w) bool of images (T, h, w, 3) uint8: where they differ from the background beyond noise."""
    difference = np.abs(images.astype(np.int16) - background).max(axis=3).astype(np.float32)
    dark, bright = np.percentile(background, (1, 99))
    bound = max(LEAST * float(bright - dark), NOISE * float(np.median(difference)), 1.0)
    kernel = np.ones((3, 3), np.uint8)
    found = np.zeros(difference.shape, bool)
    for time, one in enumerate(difference):
        moves = (cv2.blur(one, (3, 3)) > bound).astype(np.uint8)
        found[time] = cv2.morphologyEx(cv2.morphologyEx(moves, cv2.MORPH_OPEN, kernel), cv2.MORPH_CLOSE, kernel) > 0
    return found


def colors_of(points: np.ndarray, cell: float, images: Sequence[np.ndarray], cameras: Sequence[Camera]) -> np.ndarray:
    """(N, 3) uint8: the mean over the cameras that see a point before others, of all that have it in their image where
    none does."""
    total, weight = np.zeros((len(points), 3)), np.zeros(len(points))
    for image, camera in zip(images, cameras):
        column, row, depth = project(points, camera)
        seen = np.flatnonzero(in_image(column, row, depth, camera))
        x, y, z = column[seen].astype(int), row[seen].astype(int), depth[seen]
        nearest = np.full(image.shape[:2], np.inf, np.float32)
        np.minimum.at(nearest, (y, x), z.astype(np.float32))
        front = cv2.erode(nearest, np.ones((3, 3), np.uint8))
        first = np.where(z <= front[y, x] + VISIBLE * cell, 1.0, 1e-6)
        total[seen] += first[:, None] * image[y, x]
        weight[seen] += first
    return np.rint(total / np.maximum(weight, 1e-12)[:, None]).astype(np.uint8)


def background_points(
    images: Sequence[np.ndarray], cameras: Sequence[Camera], box: Box
) -> tuple[np.ndarray, np.ndarray, float]:
    """Points (N, 3), colours (N, 3) uint8 of every second pixel and row; and the share of pixels with a depth."""
    low, high = (np.broadcast_to(np.asarray(corner, np.float64), 3) for corner in box)
    middle = (low + high) / 2
    grey = [cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float32) for image in images]
    axial = [float(camera.world_to_cam[2, :3] @ middle + camera.world_to_cam[2, 3]) for camera in cameras]
    found = depths(grey, cameras, [(NEAR * depth, FAR * depth) for depth in axial])
    radius = SHELL * max(float(np.linalg.norm(camera.position - middle)) for camera in cameras)
    points, colors = [], []
    for image, camera, depth in zip(images, cameras, found):
        row, column = (axis.ravel() for axis in np.mgrid[0 : camera.height : 2, 0 : camera.width : 2])
        z = smoothed(depth)[row, column]
        rays = np.stack(
            [(column + 0.5 - camera.cx) / camera.fx, (row + 0.5 - camera.cy) / camera.fy, np.ones(len(row))], axis=1
        ) @ camera.world_to_cam[:3, :3]  # fmt: skip
        z = np.where(z > 0, z, _to_sphere(camera.position - middle, rays, radius))
        points.append(camera.position + z[:, None] * rays)
        colors.append(image[row, column])
    return np.concatenate(points), np.concatenate(colors), float(np.mean([(depth > 0).mean() for depth in found]))


def smoothed(depth: np.ndarray) -> np.ndarray:
    """Depths (h, w) without those that are far from the median of their window; that where there is none, if enough
    pixels of the window have one, else 0."""
    reach = WINDOW // 2
    padded = np.pad(np.where(depth > 0, depth, np.nan), reach, constant_values=np.nan).astype(np.float32)
    windows = np.lib.stride_tricks.sliding_window_view(padded, (WINDOW, WINDOW)).reshape(*depth.shape, -1)
    enough = np.isfinite(windows).mean(axis=2) >= LEAST_SHARE
    median = np.zeros_like(depth)
    median[enough] = np.nanmedian(windows[enough], axis=1)
    near = (depth > 0) & (np.abs(depth - median) <= SAME_SURFACE * median)
    return np.where(near, depth, median)


def _to_sphere(origin: np.ndarray, rays: np.ndarray, radius: float) -> np.ndarray:
    """(N,) multiples of the rays (N, 3) from `origin`, inside, to the sphere around (0, 0, 0)."""
    a, b = np.einsum("ni,ni->n", rays, rays), rays @ origin
    return (-b + np.sqrt(b**2 - a * (origin @ origin - radius**2))) / a


def _explained(points: np.ndarray, cell: float, silhouettes: Sequence[np.ndarray], cameras: Sequence[Camera]) -> float:
    """The share of the silhouettes' pixels that the hull covers, mean over cameras that see something move."""
    shares = []
    for silhouette, camera in zip(silhouettes, cameras):
        if not silhouette.any():
            continue
        covered = np.zeros(silhouette.shape, np.uint8)
        column, row, depth = project(points, camera)
        seen = in_image(column, row, depth, camera)
        covered[row[seen].astype(int), column[seen].astype(int)] = 1
        side = 2 * int(np.ceil(cell * camera.fx / np.median(depth[seen]))) + 1 if seen.any() else 1
        shares.append(float(cv2.dilate(covered, np.ones((side, side), np.uint8))[silhouette].mean()))
    return float(np.mean(shares))
