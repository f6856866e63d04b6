"""Training images as the loss takes them: float (3, H, W) tensors at the resolution of the current phase."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from datasets.scene import View
from rasterizer import Camera

# Above this the images of a scene stay uint8 and are converted at each use: a float copy is four times as large.
CACHE_LIMIT_BYTES = 2 * 1024**3


@dataclass(frozen=True)
class Target:
    """One view to train on."""

    name: str
    time: float
    camera: Camera
    image: Tensor  # (3, H, W) float32 in [0, 1]
    alpha: Tensor | None = None  # (1, H, W) float32 in [0, 1], 0 where only background shows; None: 1 everywhere


def target_of(view: View, scale: float) -> Target:
    """The view at `scale` of its size, each side rounded to whole pixels (at least 1); averaged over areas."""
    camera = camera_at(view.camera, scale)
    planes = np.asarray(view.image).transpose(2, 0, 1)
    if view.coverage is not None:
        planes = np.concatenate([planes, view.coverage[None]])
    planes = np.ascontiguousarray(planes, dtype=np.float32) / np.float32(255)
    if camera is not view.camera:
        height, width = planes.shape[1:]
        planes = area_weights(height, camera.height) @ planes @ area_weights(width, camera.width).T
    planes = torch.from_numpy(np.ascontiguousarray(planes))
    return Target(view.name, view.time, camera, planes[:3], planes[3:] if view.coverage is not None else None)


def camera_at(camera: Camera, scale: float) -> Camera:
    """The camera at `scale` of its size, each side rounded to whole pixels (at least 1); itself at its own size."""
    size = max(1, round(camera.width * scale)), max(1, round(camera.height * scale))
    return camera if size == (camera.width, camera.height) else camera.resized(*size)


def spread(count: int, wanted: int) -> list[int]:
    """`wanted` of `count` indices, evenly from first to last; -1 or too many: all."""
    if wanted < 0 or wanted >= count:
        return list(range(count))
    return np.unique(np.linspace(0, count - 1, wanted).round().astype(int)).tolist()


def area_weights(pixels: int, fewer: int) -> np.ndarray:
    """(fewer, pixels) float32: what part of each new pixel each old one covers. Rows sum to 1."""
    edges = np.arange(fewer + 1) * (pixels / fewer)  # of the new pixels, in units of old ones
    old = np.arange(pixels)
    overlap = np.minimum(edges[1:, None], old + 1) - np.maximum(edges[:-1, None], old)
    return (np.maximum(overlap, 0.0) * (fewer / pixels)).astype(np.float32)


class TrainingViews:
    """`target_of` for a fixed list of views, remembered for the scale last asked for while memory allows."""

    def __init__(self, views: Sequence[View], cache_limit_bytes: int = CACHE_LIMIT_BYTES) -> None:
        self._views = views
        self._pixels = sum(view.image.shape[0] * view.image.shape[1] for view in views)
        self._limit = cache_limit_bytes
        self._scale: float | None = None
        self._cache: dict[int, Target] = {}

    def at(self, index: int, scale: float) -> Target:
        if scale != self._scale:
            self._scale, self._cache = scale, {}
        target = self._cache.get(index)
        if target is None:
            target = target_of(self._views[index], scale)
            if self._pixels * scale**2 * 12 <= self._limit:  # 3 channels of 4 bytes
                self._cache[index] = target
        return target
