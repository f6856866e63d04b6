"""Pruning by sensitivity: only the Gaussians with the largest image sensitivity are kept."""

from __future__ import annotations

import torch
from torch import Tensor

from pipeline.model.model import GLOBAL_TENSORS, Model


def prune_by_sensitivity(model: Model, sensitivity: Tensor, keep: float) -> Model:
    """A model of the fraction `keep` (0 to 1) of the Gaussians with the largest `sensitivity` (N,), in their order.

    At least one is kept. Of equal sensitivities the lower index is kept. The model given stays as it is.
    """
    count = max(1, round(keep * len(model)))
    kept = torch.sort(sensitivity, descending=True, stable=True).indices[:count].sort().values
    state = {name: tensor if name in GLOBAL_TENSORS else tensor[kept] for name, tensor in model.state().items()}
    return Model.restored(model.kind, state)
