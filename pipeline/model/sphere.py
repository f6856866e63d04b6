"""The paper's background model: Gaussians on a sphere around the scene, frozen after 10,000 iterations.

They are ordinary Gaussians with a label (`Model.sphere`). The paper says only that they are fixed after 10,000
iterations. Our own rules:
- until they are frozen, Adam and opacity resets treat them like the others; afterwards nothing changes them;
- they are never cloned or split, because their number is chosen to cover the sphere;
- they are never pruned for their size, because they are large by design; they are pruned for transparency until frozen;
- `densify.max_gaussians` does not count them.
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation
from torch import Tensor

from pipeline.model.model import Model

GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))


def sphere_points(count: int, centre: ArrayLike, radius: float, rng: np.random.Generator) -> np.ndarray:
    """(count, 3) evenly spaced points on the sphere, in the units of `centre` (3,) and `radius`, randomly rotated.

    A Fibonacci lattice: equal steps in z, each rotated by the golden angle. Independent random points would leave gaps
    2.5 times as wide (measured with 5,000), which stay, because the sphere is not densified.
    """
    index = np.arange(count)
    z = 1 - (2 * index + 1) / count
    ring, angle = np.sqrt(1 - z**2), GOLDEN_ANGLE * index
    points = np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=1)
    return np.asarray(centre) + radius * Rotation.random(None, rng).apply(points)


def trainable_rows(model: Model, train_sphere: bool, visible: Tensor | None) -> Tensor | None:
    """(N,) uint8 mask of the Gaussians that Adam updates, or None for all: those of `visible` (N,) uint8 (None: all),
    without the sphere's once it is frozen."""
    if model.sphere is None or train_sphere:
        return visible
    others = (~model.sphere).to(torch.uint8)
    return others if visible is None else others & visible
