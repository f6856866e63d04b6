"""The random streams of a run: one a purpose, all of them from the run's seed.

What one purpose draws then never shifts what another draws. The numbers are part of every result: a new purpose takes
the next one, and none changes.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np
import torch


class Stream(IntEnum):
    """What a stream is for."""

    INIT = 0  # positions, times and orientations of the first Gaussians
    BATCHES = 1  # which views an iteration trains on
    # 2 and 5 were of parts that are gone
    SENSITIVITY = 3  # signs of the estimate of image sensitivity; by iteration
    ERROR_POINTS = 4  # where and when the error is; by iteration
    MARGINAL = 6  # by how much the times of the temporal marginals are shifted; by iteration
    TRAJECTORIES = 7  # where shared trajectories start
    RIGID = 8  # pairs of neighbours and a time; by view


def stream(seed: int, purpose: Stream, *moment: int) -> np.random.Generator:
    """A generator of its own for a purpose. moment: the iteration, where each one draws anew whatever was before it."""
    return np.random.default_rng([seed, int(purpose), *moment])


def split_stream(seed: int) -> torch.Generator:
    """Where split Gaussians' children lie, which torch draws: a run's checkpoint keeps its state."""
    return torch.Generator().manual_seed(seed)
