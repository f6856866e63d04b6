"""Random background colours for training images with transparency.

Over a constant background, Gaussians of its colour in empty space cost nothing: no training image shows them, but they
occlude other views.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from datasets.composition import Color
from pipeline.data.training_views import Target


def over_random_background(target: Target, background: Color, rng: np.random.Generator) -> tuple[Target, Color]:
    """The target over a uniformly random colour, and that colour; unchanged for a target without transparency.

    background: the colour that the target's image is composed over.
    """
    if target.alpha is None:
        return target, background
    red, green, blue = rng.random(3).tolist()
    change = torch.tensor((red, green, blue)) - torch.tensor(background)
    return replace(target, image=target.image + (1 - target.alpha) * change[:, None, None]), (red, green, blue)
