"""What stands far behind a scene, as the paper models it: Gaussians on a sphere round it, frozen after a while.

They are Gaussians like all others, with a label (`Model.sphere`). Of their training the paper says one thing: they
are fixed after `train.sphere_freeze_after` iterations. The rest is ours:
- until then Adam and opacity resets treat them like the others; afterwards nothing changes them;
- they are never cloned or split: their number is what covers the sphere, not what the loss pulls at;
- they are never pruned for their size, being large by nature, but for transparency until they are frozen;
- `densify.max_gaussians` counts the others only.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from pipeline.model.model import Model

GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))


def sphere_points(count: int, centre: Sequence[float], radius: float, generator: np.random.Generator) -> np.ndarray:
    """(count, 3) points evenly on the sphere, in the units of `centre` (3,) and `radius`, turned at random.

    Fibonacci's spiral: equal steps in z, each the golden angle further round. Independent random points would leave
    holes 2.5 times as wide (measured with 5,000), which nothing fills: the sphere is not densified.
    """
    index = np.arange(count)
    z = 1 - (2 * index + 1) / count
    across, angle = np.sqrt(1 - z**2), GOLDEN_ANGLE * index
    points = np.stack([across * np.cos(angle), across * np.sin(angle), z], axis=1)
    return np.asarray(centre) + radius * Rotation.random(None, generator).apply(points)


def trainable_rows(model: Model, train_sphere: bool, touched: Tensor | None) -> Tensor | None:
    """(N,) uint8, 1 for the Gaussians that Adam steps: those `touched` (N,) uint8 marks, None for all, and of these
    not the sphere's once it is no longer trained. None: all of them."""
    if model.sphere is None or train_sphere:
        return touched
    others = (~model.sphere).to(torch.uint8)
    return others if touched is None else others & touched
