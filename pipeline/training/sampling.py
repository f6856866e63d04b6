"""Sampling of batches of training views (docs/method.md 2).

Every sampler iterates over a shuffled list of groups of views and reshuffles it at the end of an epoch. Its state is a
permutation, a position in it and the state of its rng, so that a resumed run draws the same batches.
"""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Hashable, Sequence

import numpy as np

from datasets.scene import View

SAMPLERS = ("pairs", "views_at_one_time", "times_of_one_view")


def refuse_large_batch(views: int, kind: str, batch: int) -> None:
    """ValueError, one line, for a batch of pairs larger than the number of views."""
    if kind == "pairs" and batch > views:
        raise ValueError(f"train.batch: expected at most the {views} training views, found {batch}")


class BatchSampler:
    """Endless batches of indices of training views.

    - `pairs`: every (view, time) pair once per epoch in random order; the last, partial batch of an epoch is dropped.
    - `views_at_one_time`: a batch is one time, with up to `batch` cameras drawn without replacement.
    - `times_of_one_view`: a batch is one camera, at up to `batch` times drawn without replacement.

    In the last two every group is drawn once per epoch, and a batch is no larger than its group. With one moving
    camera, where no two views share a time or a pose, both have batches of 1.
    """

    def __init__(self, views: Sequence[View], kind: str, batch: int, rng: np.random.Generator) -> None:
        """Raises ValueError for an unknown kind, and for a batch of pairs larger than the number of views."""
        if kind not in SAMPLERS:
            raise ValueError(f"train.sampler: expected one of {SAMPLERS}, found {kind!r}")
        refuse_large_batch(len(views), kind, batch)
        self._batch = batch
        self._pairs = kind == "pairs"
        self._groups = _groups([_group_key(view, i, kind) for i, view in enumerate(views)])
        self._rng = rng
        self._order = self._shuffled()
        self._position = 0

    def next_batch(self) -> list[int]:
        """Indices of the next batch's views."""
        take = self._batch if self._pairs else 1
        if self._position + take > len(self._order):
            self._order, self._position = self._shuffled(), 0
        chosen = self._order[self._position : self._position + take]
        self._position += take
        if self._pairs:
            return chosen.tolist()
        group = self._groups[chosen[0]]
        return self._rng.permutation(group)[: self._batch].tolist()

    def _shuffled(self) -> np.ndarray:
        return self._rng.permutation(len(self._groups))

    def state(self) -> dict:
        """Everything that the next batches depend on; JSON-serialisable except the int64 array `order`."""
        return {
            "order": self._order.copy(),
            "position": self._position,
            "generator": json.dumps(self._rng.bit_generator.state, sort_keys=True),
        }

    def restore(self, state: dict) -> None:
        """Continue from a `state()` of a sampler over the same views. Raises ValueError for other views."""
        if len(state["order"]) != len(self._groups):
            raise ValueError(
                f"checkpoint: expected a sampler of {len(self._groups)} groups of views as the scene "
                f"has, found {len(state['order'])}"
            )
        self._order, self._position = np.array(state["order"]), int(state["position"])
        self._rng.bit_generator.state = json.loads(state["generator"])


def _group_key(view: View, index: int, kind: str) -> Hashable:
    if kind == "views_at_one_time":
        return view.time
    if kind == "times_of_one_view":
        c = view.camera
        return (c.width, c.height, c.fx, c.fy, c.cx, c.cy, c.world_to_cam.tobytes())
    return index


def _groups(keys: Sequence[Hashable]) -> list[list[int]]:
    """Indices grouped by key, in order of first appearance."""
    groups: dict[Hashable, list[int]] = defaultdict(list)
    for index, key in enumerate(keys):
        groups[key].append(index)
    return list(groups.values())
