"""Targets of the depth loss: the inverse depths of the LiDAR points that a training view sees, at its own time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from datasets.scene import Scene
from datasets.urban.projection import depth_image
from rasterizer import Camera


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
