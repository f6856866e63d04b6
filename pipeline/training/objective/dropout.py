"""Dropout of Gaussians: each training view is rendered without a random share of them, as in DropGaussian (Park et al.,
CVPR 2025). Not in the paper.

Where few views show a moment, Gaussians learn to correct each other's errors in the images they are trained on. A
Gaussian cannot rely on others that are missing at times. DropGaussian also multiplies the remaining opacities by
1 / (1 - rate); here that made no difference (docs/method.md 5.2).

Evaluation has all Gaussians, and long-lived ones, which many views determine, are better if the end of training has
them, too. There short-lived ones alone are left out.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from pipeline.model.model import Model

DROPPED_LOGIT = -30.0  # an opacity of 1e-13, which the rasterizer skips


def draw_dropped(count: int, rate: float, rng: np.random.Generator) -> Tensor:
    """(count,) bool: each Gaussian with probability `rate`."""
    return torch.from_numpy(rng.random(count, dtype=np.float32) < rate)


def short_lived(model: Model, temporal_scale: float) -> Tensor:
    """(N,) bool: st < `temporal_scale`, in units of time; in a static model none."""
    if model.kind.dims == 3:
        return torch.zeros(len(model), dtype=torch.bool)
    return model.parameters["log_scale"][:, 3].exp() < temporal_scale


def without(model: Model, dropped: Tensor) -> Model:
    """`model` with the Gaussians `dropped` (N,) bool invisible. It shares every tensor but the opacities, so that
    gradients of the others are those of `model`."""
    logit = model.parameters["opacity_logit"].masked_fill(dropped.to(model.device), DROPPED_LOGIT)
    return model.with_parameters({**model.parameters, "opacity_logit": logit})
