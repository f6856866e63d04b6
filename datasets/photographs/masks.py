"""Masks of photographs: which pixels count. Tools write them as grey of 0 and 1 or 0 and 255, as JPEG, or as alpha."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from datasets.cameras.lens import undistort
from datasets.composition import BLACK, compose
from datasets.files.errors import SceneError
from datasets.files.image_files import is_file, read_rgba
from datasets.photographs.photograph import PosedFile
from datasets.scene import ScenePoints, View
from datasets.source import Log
from datasets.urban.projection import in_image, project

NOISE = 32  # of 255: how far a lossy file's black and white may be off
TWO_VALUES = 0.95  # of the pixels: as many near black or white make a mask of these two, and not one of labels
INVERTED = 0.25  # × the share of pixels that count: masks where points count more rarely may be inverted
LOOKED_AT = 10_000  # points suffice for that
SAME_MASK = 0.99  # of the pixels in which colour and alpha agree


def read_mask(photograph: PosedFile, downscale: int) -> np.ndarray | None:
    """(H, W) bool of the reduced image: pixels all of whose parts count. None: without a mask."""
    if photograph.mask is None:
        return None
    if not is_file(photograph.mask):
        raise SceneError(photograph.mask, f"the mask of {photograph.name}", "no such file")
    rgba = read_rgba(photograph.mask)
    camera = photograph.camera
    width, height = photograph.file_size
    if abs(rgba.shape[1] * height - rgba.shape[0] * width) > max(width, height, *rgba.shape):  # a side is rounded
        raise SceneError(
            photograph.mask,
            f"{width} x {height} pixels, as its image, or of that shape",
            "{1} x {0}".format(*rgba.shape),
        )
    counts = np.where(mask_of(rgba, photograph.mask), 255, 0).astype(np.uint8)
    counts = np.asarray(cv2.resize(counts, (width, height), interpolation=cv2.INTER_NEAREST), np.uint8)
    if photograph.lens:
        counts = undistort(counts, photograph.lens.maps((width, height)))
    counts = counts[: camera.height, : camera.width]
    small = compose(np.dstack([counts] * 3 + [np.full_like(counts, 255)]), BLACK, downscale)[..., 0]
    return small == 255


def mask_of(rgba: np.ndarray, path: Path) -> np.ndarray:
    """(H, W) bool of a mask's pixels (H, W, 4) uint8: by its colour or its alpha, whichever varies.

    SceneError where both vary and differ.
    """
    by_color, by_alpha = _is_set(rgba[..., :3].max(axis=2)), _is_set(rgba[..., 3])
    if by_alpha.all():
        return by_color
    if by_color.all() or not by_color.any() or (by_color == by_alpha).mean() >= SAME_MASK:
        return by_alpha
    raise SceneError(
        path,
        "a mask in its colour or in its alpha",
        f"two that differ: {100 * by_color.mean():.0f} % by colour, {100 * by_alpha.mean():.0f} % by alpha",
    )


def _is_set(values: np.ndarray) -> np.ndarray:
    """Whether values (H, W) uint8 are not 0; of files of black and white up to noise, whether they are white."""
    extreme = (values <= NOISE) | (values >= 255 - NOISE)
    if values.max() >= 255 - NOISE and extreme.mean() >= TWO_VALUES:
        return values > 127
    return values > 0


def say_masks(root: Path, views: Sequence[View], points: ScenePoints | None, log: Log) -> None:
    """Lines on the share of pixels that count, and on masks that look inverted, as points are where the scene is.

    SceneError if no pixel counts.
    """
    masks = [view.mask for view in views]
    share = float(np.mean([1.0 if mask is None else mask.mean() for mask in masks]))
    if share == 0:
        raise SceneError(root, "masks that are 0 where pixels do not count", "masks of 0 alone: no pixel would count")
    log(f"masks: {100 * share:.0f} % of the pixels count" + ("; they leave out nothing" if share == 1 else ""))
    if points is None:
        return
    some = points.positions[:: max(1, len(points.positions) // LOOKED_AT)]
    counted = np.concatenate([_counted(view, some) for view in views])
    if len(counted) and counted.mean() < INVERTED * share:
        log(
            f"masks: only {100 * counted.mean():.0f} % of the points in the images lie where pixels count: the masks "
            "may be inverted (0 leaves out)"
        )


def _counted(view: View, points: np.ndarray) -> np.ndarray:
    """(n,) bool of the points (N, 3) in the image: whether their pixel counts."""
    column, row, depth = project(points, view.camera)
    inside = in_image(column, row, depth, view.camera)
    if view.mask is None:
        return np.ones(np.count_nonzero(inside), dtype=bool)
    return view.mask[row[inside].astype(int), column[inside].astype(int)]
