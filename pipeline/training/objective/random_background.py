"""What is transparent in an image is trained over a new colour each time.

Over one background for good, Gaussians of its colour may stand where nothing is: no training image shows them, but
from elsewhere they hide what is behind them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from datasets.composition import Color
from pipeline.data.training_views import Target


def over_random_background(target: Target, background: Color, generator: np.random.Generator) -> tuple[Target, Color]:
    """The target over a colour drawn uniformly, and that colour; as it is, where nothing in it is transparent.

    background: what the target's image is composed over.
    """
    if target.alpha is None:
        return target, background
    drawn = tuple(generator.random(3).tolist())
    change = torch.tensor(drawn) - torch.tensor(background)
    return replace(target, image=target.image + (1 - target.alpha) * change[:, None, None]), drawn
