"""Dropout of Gaussians: each training view is rendered without a random share of them (Park et al., DropGaussian, CVPR
2025). Not in the paper.

Where few views show a moment, a Gaussian can correct the errors of others in one image. It cannot rely on them if they
are missing at times, so that each has to be right by itself. The others' opacities are multiplied by 1 / (1 - rate),
so that the expected opacity is that of the whole model.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from pipeline.model.model import Model

DROPPED_LOGIT = -30.0  # an opacity of 1e-13, which no pixel shows
MAX_OPACITY = 0.9999  # of a multiplied opacity; blending clamps α at 0.99


@dataclass(frozen=True)
class DroppedOut:
    """A model without some Gaussians, and how its opacities follow from those of the whole model."""

    model: Model  # shares every tensor but opacity_logit
    d_logit: Tensor  # (N,) ∂opacity_logit of `model` / ∂opacity_logit of the whole; 0 for a dropped Gaussian


def draw_dropped(count: int, rate: float, rng: np.random.Generator) -> Tensor:
    """(count,) bool: each Gaussian with probability `rate`."""
    return torch.from_numpy(rng.random(count, dtype=np.float32) < rate)


def drop_out(model: Model, dropped: Tensor, rate: float) -> DroppedOut:
    """`model` without the Gaussians `dropped` (N,) bool."""
    opacity = torch.sigmoid(model.parameters["opacity_logit"])
    multiplied = opacity / (1 - rate)
    clamped = multiplied > MAX_OPACITY
    logit = torch.logit(multiplied.clamp(max=MAX_OPACITY)).masked_fill_(dropped, DROPPED_LOGIT)
    # With o' = o / (1 - rate): ∂logit'/∂logit = o (1 - o) / ((1 - rate) o' (1 - o')) = (1 - o) / (1 - o').
    d_logit = ((1 - opacity) / (1 - multiplied)).masked_fill_(dropped | clamped, 0.0)
    parameters = {**model.parameters, "opacity_logit": logit}
    return DroppedOut(Model(model.kind, parameters, model.sphere, model.environment_map), d_logit)
