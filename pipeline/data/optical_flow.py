"""Optical flow between consecutive frames of one camera, measured in its images: supervision of motion.

Flow of a camera that moves contains its own motion. Rendered flow, of the camera at both times, does too.

Flow is measured by dense inverse search (Kroeger et al., ECCV 2016) in both directions, and trusted where the two
agree. On synthetic/counter at 160 px it is off by 15 % of the motion of moving pixels, with search on images of half
the width by 60 %: hence the size of its own at which it is measured.
"""

from __future__ import annotations

import math
import os
from collections import defaultdict
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Any

import cv2
import numpy as np
import torch
from torch import Tensor

from datasets.scene import Scene, View
from rasterizer import Camera

MIN_WIDTH = 320  # pixels: images are doubled up to it, or halved while they stay at least as wide
MIN_SIDE = 8  # pixels, of the search's patches
AGREEMENT, RELATIVE_AGREEMENT = 0.4, 0.05  # |forward + backward|: pixels of the measured size, part of |forward|
TRUSTED_SHARE = 0.5  # of the measured pixels that a training pixel averages
MAX_GAP = 1.5  # mean frame spacings between frames that count as consecutive
MEMORY_BYTES = 2**30  # of measured flow, beyond which it is kept in a file


@dataclass(frozen=True)
class MeasuredFlow:
    """Flow from one view's time to that of a neighbouring frame by the same camera."""

    step: float  # δ in the unit of the times; negative to the previous frame
    flow: Tensor  # (2, H, W) float32, right and down, in image widths; NaN where it is not trusted
    camera: Camera | None = None  # of the neighbouring frame, at this view's size; None: it stands still


class FlowTargets:
    """The flow of each training view to the next frame of its camera, or of the last one to the one before.

    It is measured at first use, and kept in half precision: in memory while `memory_bytes` last, then in a temporary
    file in `folder`. What finds no room there is measured anew.
    """

    def __init__(self, scene: Scene, folder: Path, memory_bytes: int = MEMORY_BYTES) -> None:
        self._views = scene.train
        self._neighbour = neighbours(scene.train, MAX_GAP * scene.frame_spacing, scene.capture == "clip")
        self._folder, self._bytes_left = folder, memory_bytes
        self._in_memory: dict[int, np.ndarray] = {}
        self._file: IO[bytes] | None = None
        self._in_file: dict[int, tuple[int, tuple[int, ...]]] = {}  # where, and the shape

    def at(self, index: int, camera: Camera) -> MeasuredFlow | None:
        """The flow of view `index` at the size of `camera`; None for a view without a neighbour."""
        if index not in self._neighbour:
            return None
        view, other = self._views[index], self._views[self._neighbour[index]]
        flow = self._kept(index)
        if flow is None:
            measured = measure_flow(np.asarray(view.image), np.asarray(other.image))
            flow = torch.from_numpy(measured).half().numpy()  # NumPy takes ten times as long
            self._keep(index, flow)
        later = None if _same(view.camera, other.camera) else other.camera.resized(camera.width, camera.height)
        return MeasuredFlow(other.time - view.time, resized_flow(flow, camera.width, camera.height), later)

    def _kept(self, index: int) -> np.ndarray | None:
        if index not in self._in_file or self._file is None:
            return self._in_memory.get(index)
        place, shape = self._in_file[index]
        self._file.seek(place)
        return np.frombuffer(self._file.read(2 * math.prod(shape)), np.float16).reshape(shape)

    def _keep(self, index: int, flow: np.ndarray) -> None:
        if flow.nbytes <= self._bytes_left:
            self._in_memory[index] = flow
            self._bytes_left -= flow.nbytes
            return
        with suppress(OSError):
            if self._file is None:
                self._folder.mkdir(parents=True, exist_ok=True)
                # Unbuffered: after a failed write the rest stays readable.
                self._file = TemporaryFile(dir=self._folder, buffering=0)  # noqa: SIM115  open while this object lives
            place = self._file.seek(0, os.SEEK_END)
            if self._file.write(flow.tobytes()) == flow.nbytes:  # less on a full disk
                self._in_file[index] = place, flow.shape


def neighbours(views: Sequence[View], max_gap: float, one_camera: bool = False) -> dict[int, int]:
    """View -> view of the same camera at the next time, or at the previous one after the last, at most max_gap away.

    one_camera: one camera filmed all views; else cameras stand still, and one place is one camera.
    """
    by_camera = defaultdict(list)
    for index, view in enumerate(views):
        c = view.camera
        place = None if one_camera else (c.width, c.height, c.fx, c.fy, c.cx, c.cy, c.world_to_cam.tobytes())
        by_camera[place].append(index)
    found: dict[int, int] = {}
    for indices in by_camera.values():
        indices.sort(key=lambda index: views[index].time)
        pairs = [(a, b) for a, b in zip(indices, indices[1:]) if 0 < views[b].time - views[a].time <= max_gap]
        found |= {b: a for a, b in pairs} | dict(pairs)  # the next frame goes before the previous one
    return found


def measure_flow(image: np.ndarray, other: np.ndarray) -> np.ndarray:
    """(h, w, 2) float32 flow from `image` to `other`, (H, W, 3) uint8, in image widths; NaN where not trusted.

    h × w is H × W times the power of 2 that MIN_WIDTH asks for. Nothing is trusted if h is below MIN_SIDE.
    """
    width, height = measured_size(image.shape[1], image.shape[0])
    if height < MIN_SIDE:
        return np.full((height, width, 2), np.nan, np.float32)
    now, later = (_resized_grey(pixels, width, height) for pixels in (image, other))
    search = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    search.setFinestScale(0)  # the preset would stop at half the size
    no_guess: Any = None  # which OpenCV's types do not know
    forward, backward = (np.asarray(search.calc(*pair, no_guess)) for pair in ((now, later), (later, now)))

    x, y = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    outside = (np.inf, np.inf, 0, 0)
    there = cv2.remap(backward, x + forward[..., 0], y + forward[..., 1], cv2.INTER_LINEAR, borderValue=outside)
    limit = np.maximum(AGREEMENT, RELATIVE_AGREEMENT * np.linalg.norm(forward, axis=2))
    trusted = np.linalg.norm(forward + there, axis=2) < limit  # False for the infinite and NaN
    return np.where(trusted[..., None], forward / np.float32(width), np.float32(np.nan))


def measured_size(width: int, height: int) -> tuple[int, int]:
    """The size that flow is measured at: doubled or halved until the width is in [MIN_WIDTH, 2 MIN_WIDTH)."""
    scale = 2.0 ** np.ceil(np.log2(MIN_WIDTH / width))
    return max(1, round(width * scale)), max(1, round(height * scale))


def resized_flow(flow: np.ndarray, width: int, height: int) -> Tensor:
    """Flow (h, w, 2), NaN where not trusted, as (2, height, width) float32: area averages of what is trusted, NaN where
    that is less than TRUSTED_SHARE."""
    x, y = cv2.split(flow.astype(np.float32))
    trusted = np.isfinite(x).astype(np.float32)
    planes = [np.nan_to_num(x), np.nan_to_num(y), trusted]
    if trusted.shape != (height, width):
        planes = [cv2.resize(plane, (width, height), interpolation=cv2.INTER_AREA) for plane in planes]
    *sums, share = planes
    share[share < TRUSTED_SHARE] = np.nan
    return torch.from_numpy(np.stack([plane / share for plane in sums]))


def _same(a: Camera, b: Camera) -> bool:
    same_lens = (a.fx, a.fy, a.cx, a.cy) == (b.fx, b.fy, b.cx, b.cy)
    return same_lens and np.array_equal(a.world_to_cam, b.world_to_cam)


def _resized_grey(image: np.ndarray, width: int, height: int) -> np.ndarray:
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    if grey.shape == (height, width):
        return grey
    larger = width > grey.shape[1]
    return cv2.resize(grey, (width, height), interpolation=cv2.INTER_CUBIC if larger else cv2.INTER_AREA)
