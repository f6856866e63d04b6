"""The nearest Gaussians of each, which the rigidity of shared motion compares it with.

They are found again after every change of the set of Gaussians, and as often as SEARCH_EVERY says: in between, means
move by less than their distances. A checkpoint has them, because they depend on the means at the time of the search.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from pipeline.model.model import Model

NEIGHBOURS = 8  # of a Gaussian
SEARCH_EVERY = 100  # iterations


@dataclass(frozen=True)
class Neighbours:
    index: Tensor  # (N, NEIGHBOURS) int32, nearest first, on the CPU
    spacing: float  # median distance to the fourth, world units

    def __post_init__(self) -> None:
        """ValueError for what no search finds."""
        if self.index.dtype != torch.int32 or self.index.ndim != 2 or self.index.shape[1] != NEIGHBOURS:
            raise ValueError(f"neighbours: expected (N, {NEIGHBOURS}) int32, found {list(self.index.shape)}")
        if len(self.index) and not 0 <= int(self.index.min()) <= int(self.index.max()) < len(self.index):
            raise ValueError(f"neighbours: expected rows of {len(self.index)} Gaussians")


def find_neighbours(model: Model, threads: int) -> Neighbours | None:
    """By the means in space; None without shared motion, for too few Gaussians, and for means that are not finite."""
    means = model.parameters["mean"][:, :3].cpu()
    if "weights" not in model.parameters or len(means) <= NEIGHBOURS or not means.isfinite().all():
        return None
    positions = means.numpy()
    distance, index = cKDTree(positions).query(positions, k=NEIGHBOURS + 1, workers=threads)
    # The first is the Gaussian itself, or one in the same place.
    return Neighbours(torch.from_numpy(index[:, 1:].astype(np.int32)), float(np.median(distance[:, 4])))
