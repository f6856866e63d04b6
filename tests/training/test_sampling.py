"""Samplers: the composition of batches, and restoring their state."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from tiny import tiny_scene

from pipeline.training.sampling import BatchSampler


def grid(cameras: int, times: int):
    """Views of `cameras` fixed cameras at `times` times; index = camera · times + time."""
    base = tiny_scene(views=8).train
    return [
        replace(base[0], camera=replace(base[0].camera, fx=40.0 + c), time=float(t), name=f"{c}_{t}")
        for c in range(cameras)
        for t in range(times)
    ]


def test_pairs_drop_the_partial_batch_and_reshuffle_every_epoch() -> None:
    sampler = BatchSampler(grid(2, 5), "pairs", 4, np.random.default_rng(0))
    epochs = [[i for _ in range(2) for i in sampler.next_batch()] for _ in range(50)]
    assert all(len(set(epoch)) == 8 for epoch in epochs), "no view twice in an epoch"
    assert len({tuple(epoch) for epoch in epochs}) == 50
    # Each of 10 views is in an epoch with probability 4/5: 40 ± 2.83 of 50 epochs, seven deviations above 20
    counts = Counter(i for epoch in epochs for i in epoch)
    assert set(counts) == set(range(10)) and min(counts.values()) > 20


def test_views_at_one_time_covers_each_time_once_per_epoch() -> None:
    views = grid(6, 5)
    sampler = BatchSampler(views, "views_at_one_time", 4, np.random.default_rng(0))
    times = []
    for _ in range(5):
        batch = sampler.next_batch()
        assert len(set(batch)) == 4
        (time,) = {views[i].time for i in batch}
        times.append(time)
    assert sorted(times) == [0, 1, 2, 3, 4]


def test_times_of_one_view_covers_each_camera_once_per_epoch() -> None:
    views = grid(6, 3)
    sampler = BatchSampler(views, "times_of_one_view", 4, np.random.default_rng(0))
    focals = []
    for _ in range(6):
        batch = sampler.next_batch()
        assert len(set(batch)) == 3, "the whole group, which is smaller than the batch"
        (focal,) = {views[i].camera.fx for i in batch}
        focals.append(focal)
    assert sorted(focals) == [40, 41, 42, 43, 44, 45]


@pytest.mark.parametrize("kind", ["pairs", "views_at_one_time", "times_of_one_view"])
def test_a_restored_sampler_draws_the_same_batches(kind: str) -> None:
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


def test_a_batch_larger_than_the_number_of_views_is_refused() -> None:
    with pytest.raises(ValueError, match="train.batch: expected at most the 4 training views, found 5"):
        BatchSampler(grid(2, 2), "pairs", 5, np.random.default_rng(0))


def test_the_state_of_another_scene_is_refused() -> None:
    state = BatchSampler(grid(2, 2), "pairs", 2, np.random.default_rng(0)).state()
    with pytest.raises(ValueError, match="expected a sampler of 6 groups"):
        BatchSampler(grid(2, 3), "pairs", 2, np.random.default_rng(0)).restore(state)
