"""Sampling of batches of training views (docs/method.md 2).

Every (view, time) pair is drawn once per epoch in random order. The state is a permutation, a position in it and the
state of the rng, so that a resumed run draws the same batches.
"""

from __future__ import annotations

import json

import numpy as np


def refuse_large_batch(views: int, batch: int) -> None:
    """ValueError, one line, for a batch larger than the number of views."""
    if batch > views:
        raise ValueError(f"train.batch: expected at most the {views} training views, found {batch}")


class BatchSampler:
    """Endless batches of indices of training views; the last, partial batch of an epoch is dropped."""

    def __init__(self, views: int, batch: int, rng: np.random.Generator) -> None:
        """views: their number. Raises ValueError for a batch larger than it."""
        refuse_large_batch(views, batch)
        self._views, self._batch, self._rng = views, batch, rng
        self._order = rng.permutation(views)
        self._position = 0

    def next_batch(self) -> list[int]:
        """Indices of the next batch's views."""
        if self._position + self._batch > self._views:
            self._order, self._position = self._rng.permutation(self._views), 0
        chosen = self._order[self._position : self._position + self._batch]
        self._position += self._batch
        return chosen.tolist()

    def state(self) -> dict:
        """Everything that the next batches depend on; JSON-serialisable except the int64 array `order`."""
        return {
            "order": self._order.copy(),
            "position": self._position,
            "generator": json.dumps(self._rng.bit_generator.state, sort_keys=True),
        }

    def restore(self, state: dict) -> None:
        """Continue from a `state()` of a sampler over the same views. Raises ValueError for other views."""
        if len(state["order"]) != self._views:
            raise ValueError(
                f"checkpoint: expected a sampler of the scene's {self._views} views, found {len(state['order'])}"
            )
        self._order, self._position = np.array(state["order"]), int(state["position"])
        self._rng.bit_generator.state = json.loads(state["generator"])
