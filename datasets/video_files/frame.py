"""A frame in time, of a video or of a folder of images."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Frame:
    """A decoded frame."""

    index: int  # among the clip's frames, damaged ones included
    time: float  # seconds of the clip's clock
    image: np.ndarray | None  # (H, W, 3) uint8 RGB, upright; None: damaged
