"""The share of the pixels that show something: those that do not have the background's colour."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from datasets.composition import BORDER_TOLERANCE, Color
from datasets.scene import View
from pipeline.data.training_views import evenly_spaced

MAX_VIEWS = 100  # evenly spaced ones; reading every frame of a film would take a minute


def covered_share(views: Sequence[View], background: Color) -> float:
    """Mean over `views` of the share of pixels that differ from `background`, RGB in [0, 1]; 1 if no pixel does.

    Differences as small as artefacts of compression do not count.
    """
    color = 255.0 * np.asarray(background, dtype=np.float32)
    shares = []
    for index in evenly_spaced(len(views), MAX_VIEWS):
        difference = np.abs(np.asarray(views[index].image).astype(np.float32) - color)
        shares.append(float((difference.max(axis=2) > BORDER_TOLERANCE).mean()))
    return float(np.mean(shares)) or 1.0
