"""Images for the loss: views as float (3, H, W) tensors at the resolution of the current training phase."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
import torch
from torch import Tensor

from datasets.scene import View
from pipeline.data.depth_targets import DepthTargets, PointDepths, SparseDepth
from pipeline.data.optical_flow import FlowTargets, MeasuredFlow
from rasterizer import Camera

# Above this size float images are not cached but converted from uint8 at each use, and flow is resized.
CACHE_LIMIT_BYTES = 2 * 1024**3
IMAGE_BYTES, FLOW_BYTES = 12, 8  # of a pixel: three and two floats


@dataclass(frozen=True)
class Target:
    """One view to compare a render with."""

    name: str
    time: float
    camera: Camera
    image: Tensor  # (3, H, W) float32 in [0, 1]
    alpha: Tensor | None = None  # (1, H, W) float32 in [0, 1]; None: 1 everywhere
    motion: MeasuredFlow | None = None  # None: not measured
    depth: SparseDepth | None = None  # of LiDAR or structure from motion; None: unknown
    sky: Tensor | None = None  # (1, H, W) float32, share of each pixel that is sky; None: unknown
    mask: Tensor | None = None  # (H, W) bool: valid pixels; None: all

    def to(self, device: torch.device) -> Target:
        """The same view with its tensors on the device; itself if they are."""
        if self.image.device == device:
            return self
        tensors: dict[str, Any] = {n: value.to(device) for n, value in vars(self).items() if isinstance(value, Tensor)}
        motion, depth = self.motion, self.depth
        if motion is not None:
            motion = replace(motion, flow=motion.flow.to(device))
        if depth is not None:
            depth = SparseDepth(depth.pixel.to(device), depth.inverse.to(device))
        return replace(self, **tensors, motion=motion, depth=depth)


def target_of(view: View, scale: float) -> Target:
    """The view at `scale` of its size (see camera_at), reduced by area average."""
    camera = camera_at(view.camera, scale)
    planes = np.asarray(view.image)
    if view.coverage is not None:
        planes = cv2.merge([*cv2.split(planes), view.coverage])  # np.dstack takes seven times as long
    planes = area_average(planes, camera) / np.float32(255)
    # All parts of a valid pixel are valid.
    mask = None if view.mask is None else torch.from_numpy(area_average(view.mask, camera) > 1 - 1e-3)
    sky = None if view.sky is None else torch.from_numpy(area_average(view.sky, camera))[None]
    channels = torch.from_numpy(np.ascontiguousarray(planes.transpose(2, 0, 1)))
    alpha = channels[3:] if view.coverage is not None else None
    return Target(view.name, view.time, camera, channels[:3], alpha, mask=mask, sky=sky)


def camera_at(camera: Camera, scale: float) -> Camera:
    """The camera at `scale` of its size, each side rounded to whole pixels, at least 1; unchanged at its own size."""
    size = max(1, round(camera.width * scale)), max(1, round(camera.height * scale))
    return camera if size == (camera.width, camera.height) else camera.resized(*size)


def evenly_spaced(count: int, chosen: int) -> list[int]:
    """`chosen` of the indices 0 … count - 1, evenly spaced from first to last; all for -1 or chosen >= count."""
    if chosen < 0 or chosen >= count:
        return list(range(count))
    return np.unique(np.linspace(0, count - 1, chosen).round().astype(int)).tolist()


def area_average(planes: np.ndarray, camera: Camera) -> np.ndarray:
    """(H, W) or (H, W, C) of any type, averaged over the area of each pixel of `camera`, float32; H, W not smaller."""
    return cv2.resize(planes.astype(np.float32), (camera.width, camera.height), interpolation=cv2.INTER_AREA)


class TrainingViews:
    """`target_of` for a fixed list of views; caches the images of the last scale if they fit cache_limit_bytes, and
    their flow if it fits too."""

    def __init__(
        self,
        views: Sequence[View],
        flows: FlowTargets | None = None,
        depths: DepthTargets | PointDepths | None = None,
        cache_limit_bytes: int = CACHE_LIMIT_BYTES,
    ) -> None:
        """flows, depths: of the same views; None: targets have no motion, no depth."""
        self._views, self._flows, self._depths = views, flows, depths
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
            if self._fits(IMAGE_BYTES):
                self._cache[index] = target
        if self._flows is not None and target.motion is None:
            target = replace(target, motion=self._flows.at(index, target.camera))
            if self._fits(IMAGE_BYTES + FLOW_BYTES):
                self._cache[index] = target
        if self._depths is not None:
            target = replace(target, depth=self._depths.at(index, target.camera, target.image))
        return target if target.mask is None else _valid_only(target, target.mask)

    def _fits(self, bytes_per_pixel: int) -> bool:
        assert self._scale is not None
        return self._pixels * self._scale**2 * bytes_per_pixel <= self._limit


def _valid_only(target: Target, mask: Tensor) -> Target:
    """The target without the measured flow, depths and sky of the pixels outside its mask (H, W)."""
    motion, depth = target.motion, target.depth
    sky = None if target.sky is None else target.sky * mask
    if motion is not None:
        motion = replace(motion, flow=torch.where(mask, motion.flow, torch.nan))
    if depth is not None:
        valid = mask.ravel()[depth.pixel]
        depth = SparseDepth(depth.pixel[valid], depth.inverse[valid]) if valid.any() else None
    return replace(target, motion=motion, depth=depth, sky=sky)
