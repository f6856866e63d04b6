"""Batches: what each sampler promises, and that its state is all there is to it."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from tiny import tiny_scene

from pipeline.training.sampling import BatchSampler


def grid(cameras: int, times: int):
    """`cameras` fixed cameras, each seeing `times` moments; index = camera · times + moment."""
    base = tiny_scene(views=8).train
    return [
        replace(base[0], camera=replace(base[0].camera, fx=40.0 + c), time=float(t), name=f"{c}_{t}")
        for c in range(cameras)
        for t in range(times)
    ]


def test_pairs_drop_the_partial_batch_and_reshuffle() -> None:
    sampler = BatchSampler(grid(2, 5), "pairs", 4, np.random.default_rng(0))
    epochs = [[i for _ in range(2) for i in sampler.next_batch()] for _ in range(50)]
    assert all(len(set(epoch)) == 8 for epoch in epochs), "no view twice in an epoch"
    assert len({tuple(epoch) for epoch in epochs}) == 50
    # Each of 10 views is left out of an epoch with probability 1/5: 50 ± 2.83 · √… stays far from 20
    counts = Counter(i for epoch in epochs for i in epoch)
    assert set(counts) == set(range(10)) and min(counts.values()) > 20


def test_views_at_one_time() -> None:
    views = grid(6, 5)
    sampler = BatchSampler(views, "views_at_one_time", 4, np.random.default_rng(0))
    moments = []
    for _ in range(5):
        batch = sampler.next_batch()
        assert len(set(batch)) == 4
        (moment,) = {views[i].time for i in batch}
        moments.append(moment)
    assert sorted(moments) == [0, 1, 2, 3, 4], "each moment once an epoch"


def test_times_of_one_view_and_small_groups() -> None:
    views = grid(6, 3)
    sampler = BatchSampler(views, "times_of_one_view", 4, np.random.default_rng(0))
    seen = []
    for _ in range(6):
        batch = sampler.next_batch()
        assert len(set(batch)) == 3, "the whole group, being smaller than the batch"
        (focal,) = {views[i].camera.fx for i in batch}
        seen.append(focal)
    assert sorted(seen) == [40, 41, 42, 43, 44, 45]


@pytest.mark.parametrize("kind", ["pairs", "views_at_one_time", "times_of_one_view"])
def test_restored_state_draws_the_same_batches(kind: str) -> None:
    views = grid(4, 6)
    sampler = BatchSampler(views, kind, 3, np.random.default_rng(7))
    for _ in range(5):
        sampler.next_batch()
    state = sampler.state()
    json.dumps({key: value for key, value in state.items() if key != "order"})
    expected = [sampler.next_batch() for _ in range(40)]
    other = BatchSampler(views, kind, 3, np.random.default_rng(99))
    other.restore(state)
    assert [other.next_batch() for _ in range(40)] == expected


def test_batch_above_the_number_of_views_is_refused() -> None:
    with pytest.raises(ValueError, match="train.batch: expected at most the 4 training views, found 5"):
        BatchSampler(grid(2, 2), "pairs", 5, np.random.default_rng(0))


def test_state_of_another_scene_is_refused() -> None:
    state = BatchSampler(grid(2, 2), "pairs", 2, np.random.default_rng(0)).state()
    with pytest.raises(ValueError, match="expected a sampler of 6 groups"):
        BatchSampler(grid(2, 3), "pairs", 2, np.random.default_rng(0)).restore(state)
