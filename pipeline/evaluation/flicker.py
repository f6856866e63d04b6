"""Flicker: how much the error changes from one frame of a film to the next.

With the residual r_t = render_t - truth_t, images (H, W, 3) in [0, 1], it is the mean of |r_{t+1} - r_t| over pixels,
channels and pairs of consecutive frames. What moves in the scene cancels where the render follows it; an
error that stays does not count, however large it is: PSNR has that. PSNR in turn does not see the order of frames.
"""

from __future__ import annotations

import numpy as np

from datasets.scene import View
from pipeline.data.frame_order import follows


def residual(image: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """(H, W, 3) float32 in [-1, 1] of two images in [0, 1]."""
    return np.subtract(image, truth, dtype=np.float32)


def flicker(residuals: np.ndarray) -> float:
    """Of consecutive frames' residuals (F, H, W, 3), F >= 2, in their own unit."""
    return float(np.mean(np.abs(np.diff(residuals, axis=0)), dtype=np.float64))


class FlickerMeter:
    """The same, frame by frame: it keeps the frame before and no other."""

    def __init__(self, frame_rate: float | None) -> None:
        """frame_rate: frames a second; None for photographs, which do not flicker."""
        self._frame_rate = frame_rate
        self._before: tuple[View, np.ndarray] | None = None  # and its residual

    def next(self, view: View, image: np.ndarray, truth: np.ndarray) -> float | None:
        """Mean |r_t - r_{t-1}| of this frame; None where the call before was not for the frame before it."""
        if self._frame_rate is None:
            return None
        now, before = residual(image, truth), self._before
        self._before = (view, now)
        if before is None or not follows(before[0], view, self._frame_rate):
            return None
        change = np.subtract(now, before[1], out=before[1])  # of no use any more: no third image is allocated
        return float(np.mean(np.abs(change, out=change), dtype=np.float64))


def mean_flicker(changes: list[float | None]) -> float | None:
    """Mean over the frames that have one before them; None if none has."""
    known = [change for change in changes if change is not None]
    return float(np.mean(known)) if known else None
