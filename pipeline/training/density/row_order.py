"""The order of the Gaussians in memory: by time, and by place among those of about one time.

A view shows the Gaussians of its time, and a tile those of one place. In rows beside each other they are read in
sequence, and share cache lines: docs/kernel.md has what it gains. A few ten thousand are in cache in any order.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from pipeline.config.train_schema import DensifyConfig
from pipeline.model.model import Model
from pipeline.training.schedule import Phase
from pipeline.training.state import TrainState

EVERY = 1000  # iterations, while Gaussians are added
FEWEST = 50_000
TIMES = 32  # equal parts of the time that the Gaussians' means span
BITS = 10  # of each coordinate, of the space that they span


@dataclass(frozen=True)
class RowOrder:
    """Sorts the rows, with what training knows of each."""

    rules: DensifyConfig
    event = "order_rows"

    def due(self, iteration: int, clock: float) -> bool:
        return clock <= self.rules.stop and iteration % EVERY == 0

    def apply(self, state: TrainState, phase: Phase) -> dict[str, int]:
        if len(state.model) < FEWEST:
            return {"sorted": 0}
        order = memory_order(state.model)
        state.optimiser.keep(order)
        state.statistics.reorder(order)
        return {"sorted": len(state.model)}


def memory_order(model: Model) -> Tensor:
    """(N,) the present rows in their new order: by part of the time, then along a Morton curve, then as they were."""
    mean = model.parameters["mean"].detach().cpu().numpy().astype(np.float64)
    place = _steps(mean[:, :3], 2**BITS)
    curve = np.zeros(len(mean), np.int64)
    for bit in range(BITS):
        for axis in range(3):
            curve |= (place[:, axis] >> bit & 1) << (3 * bit + axis)
    time = _steps(mean[:, 3:], TIMES)[:, 0] if mean.shape[1] == 4 else np.zeros_like(curve)
    return torch.from_numpy(np.lexsort((curve, time)))  # stable


def _steps(values: np.ndarray, count: int) -> np.ndarray:
    """(N, C) which of `count` equal parts of its column's span each value is in."""
    low, span = values.min(axis=0), np.maximum(np.ptp(values, axis=0), np.finfo(np.float64).tiny)
    return np.minimum((values - low) / span * count, count - 1).astype(np.int64)
