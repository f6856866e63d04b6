"""Flicker: the mean absolute change of the error between consecutive frames of a video.

With the residual r_t = render_t - truth_t, images (H, W, 3) in [0, 1], flicker is the mean of |r_{t+1} - r_t| over
pixels, channels and pairs of consecutive frames. Motion that the render reproduces cancels. A constant error does not
count, however large; PSNR measures that, but is independent of the order of frames.
"""

from __future__ import annotations

import numpy as np

from datasets.scene import View

SPACING_TOLERANCE = 0.1  # frames; covers the rounding of times


class FlickerMeter:
    """Computed frame by frame; it keeps only the previous residual."""

    def __init__(self, frame_rate: float | None) -> None:
        """frame_rate: frames per unit of the scene's time; None for photographs, which have no flicker."""
        self._frame_rate = frame_rate
        self._before: tuple[View, np.ndarray] | None = None  # the previous view and its residual

    def next(self, view: View, image: np.ndarray, truth: np.ndarray) -> float | None:
        """Mean |r_t - r_{t-1}| of this frame; None unless the previous call was for the previous frame."""
        if self._frame_rate is None:
            return None
        now, before = np.subtract(image, truth, dtype=np.float32), self._before
        self._before = (view, now)
        if before is None or before[0].filmed_by != view.filmed_by:
            return None
        if abs((view.time - before[0].time) * self._frame_rate - 1.0) >= SPACING_TOLERANCE:
            return None
        change = np.subtract(now, before[1], out=before[1])  # reuses its memory
        return float(np.mean(np.abs(change, out=change), dtype=np.float64))
