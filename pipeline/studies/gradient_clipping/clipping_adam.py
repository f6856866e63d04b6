"""Adam with clipping by the global norm, and a record of the norms before clipping."""

from __future__ import annotations

import math
import sys

import torch
from torch import Tensor

from pipeline.model.model import Model
from pipeline.training.optimiser import Adam, LearningRate
from rasterizer import Gradients

LARGEST = 0.01  # fraction of the Gaussians, those with the largest gradients


class ClippingAdam(Adam):
    """Adam on the gradient of all parameters, scaled down to norm `threshold` where its norm is larger.

    Each step appends to `norms` the norm before clipping by field, and to `concentration` the fraction of the squared
    norm that the LARGEST gradients have.
    """

    def __init__(
        self,
        model: Model,
        threads: int = 1,
        separate_tilt: bool = False,
        *,
        threshold: float,
        norms: list[dict[str, float]],
        concentration: list[float],
    ) -> None:
        super().__init__(model, threads, separate_tilt)
        self._threshold, self._norms, self._concentration = threshold, norms, concentration

    def step(
        self,
        gradients: Gradients,
        learning_rates: dict[str, LearningRate],
        rows: Tensor | None = None,
        d_environment_map: Tensor | None = None,
    ) -> None:
        squares = squared_norms(gradients)
        found = {name: math.sqrt(each.sum().item()) for name, each in squares.items()}
        self._norms.append(found)
        total = squares["all"]
        top = total.topk(max(1, int(LARGEST * len(total)))).values.sum().item()
        self._concentration.append(top / max(total.sum().item(), sys.float_info.min))
        if found["all"] > self._threshold:
            scale_(gradients, self._threshold / found["all"])
        super().step(gradients, learning_rates, rows, d_environment_map)


def squared_norms(gradients: Gradients) -> dict[str, Tensor]:
    """(N,) squared norm of each Gaussian's gradient, float64, for each field and for "all" fields together."""
    fields = gradients.dense() | {"sh": gradients.sh()}
    norms = {name: torch.linalg.vector_norm(g.reshape(len(g), -1), dim=1) for name, g in fields.items()}
    squares = {name: norm.double().square() for name, norm in norms.items()}
    return squares | {"all": sum(squares.values())}


def scale_(gradients: Gradients, factor: float) -> None:
    """All gradients times `factor`, in place. Those of SH are linear in the colour gradients that each view holds."""
    for tensor in gradients.dense().values():
        tensor.mul_(factor)
    for view in gradients.views:
        view.gradient[:, :3].mul_(factor)
