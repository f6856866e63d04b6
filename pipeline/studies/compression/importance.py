"""Leaving out the Gaussians that are worth least: those that the training images miss least."""

from __future__ import annotations

import torch
from torch import Tensor

from pipeline.model.model import OF_THE_WHOLE, Model


def keep_most_important(model: Model, worth: Tensor, fraction: float) -> Model:
    """The `fraction` (0 to 1) of the Gaussians that are worth most, at least one, in their order; ties by index."""
    count = max(1, round(fraction * len(model)))
    kept = torch.sort(worth, descending=True, stable=True).indices[:count].sort().values
    state = {name: tensor if name in OF_THE_WHOLE else tensor[kept] for name, tensor in model.state().items()}
    return Model.restored(model.kind, state)
