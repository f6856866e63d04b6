"""Ground truth of a view's motion and geometry, read from files that a data set may have beside its images.

    IMAGE.npz                 beside an image of the D-NeRF layout
        moving      (H, W) bool: the visible body changes its pose with time, appears or vanishes
        depth       (H, W) z at pixel centres, world units; 0 where there is nothing
        flow        (2, H, W) pixels right and down to time + flow_dt, same camera
        flow_valid  (H, W) bool: where the flow is known
        flow_dt     the file's unit of time
    truth/camNN.npz           beside the videos of the Plenoptic Video layout
        still_depth (H, W) of the bodies that never change, flow_dt; per frame i: moving_i, flow_i, flow_valid_i as
        above, and depth_i, 0 where a body of still_depth is seen

Arrays that a file lacks are unknown. Sizes are those of the full images.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from datasets.files.errors import SceneError


@dataclass(frozen=True)
class GroundTruth:
    """What is known of one view; None: unknown. All arrays have the view's size."""

    moving: np.ndarray | None = None  # (H, W) bool
    depth: np.ndarray | None = None  # (H, W) float32 z at pixel centres, units of the scene; 0: unknown
    flow: np.ndarray | None = None  # (2, H, W) float32 pixels right and down to time + flow_dt
    flow_valid: np.ndarray | None = None  # (H, W) bool; not None where flow is not
    flow_dt: float | None = None  # the scene's unit of time

    def resized(self, width: int, height: int) -> GroundTruth:
        """Of another size. A pixel moves if any of those that it covers does; depth and flow are those of the pixel at
        its centre, flow in the new pixels."""
        arrays = self._arrays()
        if not arrays or next(iter(arrays.values())).shape[-2:] == (height, width):
            return self
        old_height, old_width = next(iter(arrays.values())).shape[-2:]
        rows, columns = _centres(old_height, height)[:, None], _centres(old_width, width)
        found = {name: array[..., rows, columns] for name, array in arrays.items()}
        if self.moving is not None:
            found["moving"] = any_moving(self.moving, width, height)
        if self.flow is not None:
            found["flow"] = found["flow"] * np.array([[[width / old_width]], [[height / old_height]]], np.float32)
        return GroundTruth(**found, flow_dt=self.flow_dt)

    def _arrays(self) -> dict[str, np.ndarray]:
        known = {name: getattr(self, name) for name in ("moving", "depth", "flow", "flow_valid")}
        return {name: array for name, array in known.items() if array is not None}


@dataclass(frozen=True)
class StoredTruth:
    """The ground truth of one view, read at each call of `read`."""

    path: Path
    frame: int | None = None  # of a film's file; None: the file has one image
    downscale: int = 1  # of the view, as in composition.compose
    length_scale: float = 1.0  # units of the scene per world unit of the file
    time_scale: float = 1.0  # units of the scene's time per unit of the file
    has_depth: bool = True  # False: depth is unknown, for poses and their unit of length are not the file's

    def in_units(self, length_scale: float, time_scale: float) -> StoredTruth:
        """For a scene whose lengths and times are scaled once more."""
        lengths, times = self.length_scale * length_scale, self.time_scale * time_scale
        return replace(self, length_scale=lengths, time_scale=times)

    def read(self, moving_only: bool = False) -> GroundTruth:
        """moving_only: leaves depth and flow unread, as if unknown. SceneError for a file that cannot be read."""
        try:
            with np.load(self.path) as file:
                truth = self._of(file, moving_only)
        except (OSError, ValueError, BadZipFile, EOFError) as error:
            raise SceneError(self.path, "arrays of ground truth (datasets/ground_truth.py)", str(error)) from None
        arrays, side = truth._arrays(), self.downscale
        if side == 1 or not arrays:
            return truth
        height, width = (whole // side for whole in next(iter(arrays.values())).shape[-2:])
        cropped = {name: array[..., : height * side, : width * side] for name, array in arrays.items()}
        return GroundTruth(**cropped, flow_dt=truth.flow_dt).resized(width, height)

    def _of(self, file: np.lib.npyio.NpzFile, moving_only: bool) -> GroundTruth:
        def array(name: str, kind: type) -> np.ndarray | None:
            key = name if self.frame is None else f"{name}_{self.frame:04d}"
            return file[key].astype(kind) if key in file else None

        moving = array("moving", bool)
        if moving_only:
            return GroundTruth(moving)
        depth = array("depth", np.float32) if self.has_depth else None
        if depth is not None and "still_depth" in file:
            depth = np.where(depth > 0, depth, file["still_depth"].astype(np.float32))
        flow = array("flow", np.float32) if "flow_dt" in file else None
        valid = array("flow_valid", bool)
        if flow is not None and valid is None:
            valid = np.ones(flow.shape[1:], dtype=bool)
        return GroundTruth(
            moving=moving,
            depth=None if depth is None else depth * np.float32(self.length_scale),
            flow=flow,
            flow_valid=None if flow is None else valid,
            flow_dt=None if flow is None else float(file["flow_dt"]) * self.time_scale,
        )


def any_moving(moving: np.ndarray, width: int, height: int) -> np.ndarray:
    """(height, width) bool: whether any of the pixels of `moving` (H, W) that a new pixel covers is True."""
    if moving.shape == (height, width):
        return moving
    rows, columns = _overlap(moving.shape[0], height), _overlap(moving.shape[1], width)
    return rows @ moving.astype(np.float32) @ columns.T > 0


def _centres(pixels: int, fewer: int) -> np.ndarray:
    """(fewer,) the old pixel at the centre of each new one; of two at the same distance the later."""
    return np.minimum(((np.arange(fewer) + 0.5) * (pixels / fewer)).astype(int), pixels - 1)


def _overlap(pixels: int, fewer: int) -> np.ndarray:
    """(fewer, pixels) float32: 1 where a new pixel covers a part of an old one."""
    first, last = np.arange(fewer) * pixels, (np.arange(fewer) + 1) * pixels  # in units of 1 / fewer old pixels
    old = np.arange(pixels) * fewer
    return ((np.minimum(last[:, None], old + fewer) - np.maximum(first[:, None], old)) > 0).astype(np.float32)
