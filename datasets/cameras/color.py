"""Colour correction of a camera: a gain and an offset for each channel."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

Channels = tuple[float, float, float]


@dataclass(frozen=True)
class ColorCorrection:
    """corrected = gain × value + offset, of red, green and blue as the files have them (gamma included)."""

    gain: Channels = (1.0, 1.0, 1.0)
    offset: Channels = (0.0, 0.0, 0.0)  # of 255

    @classmethod
    def from_arrays(cls, gain: np.ndarray, offset: np.ndarray) -> ColorCorrection:
        """Of two (3,)."""
        return cls(tuple(gain.tolist()), tuple(offset.tolist()))

    def of(self, colors: np.ndarray) -> np.ndarray:
        """(…, 3) values of 255 -> (…, 3) float64, not rounded, not clipped."""
        return np.asarray(colors, dtype=np.float64) * self.gain + self.offset

    def apply(self, image: np.ndarray) -> np.ndarray:
        """(H, W, 3) uint8 -> the corrected image, uint8."""
        table = self.of(np.repeat(np.arange(256)[:, None], 3, axis=1))
        return cv2.LUT(image, np.rint(np.clip(table, 0, 255)).astype(np.uint8)[None])
