"""Targets of the depth loss: inverse depths at some pixels of a view, of LiDAR or of points of structure from motion.

LiDAR's are at the view's own time. A point of structure from motion is where it was when it was seen, and something may
move or stand before it: a view's pixel counts while it has the point's colour.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from datasets.scene import Scene, ScenePoints
from datasets.urban.projection import depth_image, in_image, project
from rasterizer import Camera

MOST_DIFFERENT = 0.1  # in each channel, of a pixel and its point; in [0, 1]


@dataclass(frozen=True)
class SparseDepth:
    """Depths at some pixels of a view."""

    pixel: Tensor  # (n,) int64, row × width + column
    inverse: Tensor  # (n,) float32, one over the depth z in scene units


class DepthTargets:
    """The LiDAR depths of each training view at the size of a camera; those of the last size are kept."""

    def __init__(self, scene: Scene) -> None:
        self._views = scene.train
        self._sweeps = {sweep.frame: sweep for sweep in scene.sweeps}
        self._cache: dict[int, tuple[tuple[int, int], SparseDepth]] = {}

    def at(self, index: int, camera: Camera, image: Tensor | None = None) -> SparseDepth | None:
        """Of view `index`; None: its frame has no sweep, or the view sees no point of it. image: not needed."""
        frame = self._views[index].frame
        if frame is None or frame not in self._sweeps:
            return None
        size = camera.width, camera.height
        if index not in self._cache or self._cache[index][0] != size:
            self._cache[index] = size, sparse(depth_image(self._sweeps[frame].points, camera))
        found = self._cache[index][1]
        return found if len(found.pixel) else None


def sparse(depth: np.ndarray) -> SparseDepth:
    """The pixels of a depth image (H, W) whose depth is above 0."""
    pixel = np.flatnonzero(depth)
    return SparseDepth(torch.from_numpy(pixel), torch.from_numpy(1 / depth.reshape(-1)[pixel]))


class PointDepths:
    """The points' depths in each training view; those of each camera are kept at its last size."""

    def __init__(self, scene: Scene, points: ScenePoints) -> None:
        """points: in the scene's coordinates."""
        self._views, self._points = scene.train, points
        seen_by = points.seen_by
        self._seen: dict[bytes, np.ndarray] | None = None  # by the pose of the camera
        if seen_by is not None:
            self._seen = {v.camera.world_to_cam.tobytes(): seen_by[v.name] for v in scene.train if v.name in seen_by}
        self._cache: dict[tuple, tuple[tuple[int, int], SparseDepth, Tensor]] = {}  # size, depths, colours

    def at(self, index: int, camera: Camera, image: Tensor) -> SparseDepth | None:
        """Of view `index` at the size of `camera`, whose image (3, H, W) in [0, 1] is given; None without a point."""
        c, size = self._views[index].camera, (camera.width, camera.height)
        key = (c.fx, c.fy, c.cx, c.cy, c.world_to_cam.tobytes())
        if key not in self._cache or self._cache[key][0] != size:
            self._cache[key] = size, *_projected(self._shown_by(c), camera)
        _, found, color = self._cache[key]
        shown = image.reshape(3, -1)[:, found.pixel]
        same = (shown - color).abs().amax(dim=0) <= MOST_DIFFERENT
        return SparseDepth(found.pixel[same], found.inverse[same]) if same.any() else None

    def _shown_by(self, camera: Camera) -> ScenePoints:
        if self._seen is None:
            return self._points
        rows = self._seen.get(camera.world_to_cam.tobytes(), np.zeros(0, dtype=int))
        return ScenePoints(self._points.positions[rows], self._points.colors[rows])


def _projected(points: ScenePoints, camera: Camera) -> tuple[SparseDepth, Tensor]:
    """The points in an image, the nearest of each pixel, and their colours (3, n) float32 in [0, 1]."""
    column, row, depth = project(points.positions, camera)
    index = np.flatnonzero(in_image(column, row, depth, camera))
    index = index[np.argsort(depth[index], kind="stable")]
    pixels = row[index].astype(int) * camera.width + column[index].astype(int)
    pixel, first = np.unique(pixels, return_index=True)  # the first of a pixel is the nearest
    nearest = index[first]
    color = points.colors[nearest].T.astype(np.float32) / 255
    inverse = torch.from_numpy((1 / depth[nearest]).astype(np.float32))
    return SparseDepth(torch.from_numpy(pixel), inverse), torch.from_numpy(np.ascontiguousarray(color))
