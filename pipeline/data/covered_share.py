"""The share of the pixels that show something: those that do not have the background's colour."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from datasets.composition import Color
from datasets.scene import View
from pipeline.data.training_views import evenly_spaced

MAX_VIEWS = 100  # evenly spaced ones; reading every frame of a film would take a minute
TOLERANCE = 8  # levels of 255 in each channel: JPEG artefacts, and the faint edges of a soft alpha


def covered_share(views: Sequence[View], background: Color) -> float:
    """Mean over `views` of the share of pixels that differ from `background`, RGB in [0, 1]; 1 if no pixel does."""
    color = 255.0 * np.asarray(background, dtype=np.float32)
    shares = []
    for index in evenly_spaced(len(views), MAX_VIEWS):
        difference = np.abs(np.asarray(views[index].image).astype(np.float32) - color)
        shares.append(float((difference.max(axis=2) > TOLERANCE).mean()))
    return float(np.mean(shares)) or 1.0
