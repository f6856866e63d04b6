"""The share of the pixels that the loss learns from: those that count and do not have the background's colour."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from datasets.composition import BORDER_TOLERANCE, Color
from datasets.scene import View
from pipeline.data.training_views import evenly_spaced

MAX_VIEWS = 100  # evenly spaced ones; reading every frame of a film would take a minute


def covered_share(views: Sequence[View], background: Color) -> float:
    """Mean over `views` of the share of pixels that differ from `background`, RGB in [0, 1]; 1 if no pixel does.

    Neither differences as small as artefacts of compression nor pixels outside of a view's mask count.
    """
    color = 255.0 * np.asarray(background, dtype=np.float32)
    shares = []
    for index in evenly_spaced(len(views), MAX_VIEWS):
        view = views[index]
        covered = np.abs(np.asarray(view.image).astype(np.float32) - color).max(axis=2) > BORDER_TOLERANCE
        shares.append(float((covered if view.mask is None else covered & view.mask).mean()))
    return float(np.mean(shares)) or 1.0
