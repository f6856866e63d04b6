"""The sampler: the composition of batches, and restoring their state."""

from __future__ import annotations

import json
from collections import Counter

import numpy as np
import pytest

from pipeline.training.sampling import BatchSampler


def test_the_sampler_drops_the_partial_batch_and_reshuffles_every_epoch() -> None:
    sampler = BatchSampler(10, 4, np.random.default_rng(0))
    epochs = [[i for _ in range(2) for i in sampler.next_batch()] for _ in range(50)]
    assert all(len(set(epoch)) == 8 for epoch in epochs), "no view twice in an epoch"
    assert len({tuple(epoch) for epoch in epochs}) == 50
    # Each of 10 views is in an epoch with probability 4/5: 40 ± 2.83 of 50 epochs, seven deviations above 20
    counts = Counter(i for epoch in epochs for i in epoch)
    assert set(counts) == set(range(10)) and min(counts.values()) > 20


def test_a_restored_sampler_draws_the_same_batches() -> None:
    sampler = BatchSampler(24, 3, np.random.default_rng(7))
    for _ in range(5):
        sampler.next_batch()
    state = sampler.state()
    json.dumps({key: value for key, value in state.items() if key != "order"})
    expected = [sampler.next_batch() for _ in range(40)]
    other = BatchSampler(24, 3, np.random.default_rng(99))
    other.restore(state)
    assert [other.next_batch() for _ in range(40)] == expected


def test_a_batch_larger_than_the_number_of_views_is_refused() -> None:
    with pytest.raises(ValueError, match="train.batch: expected at most the 4 training views, found 5"):
        BatchSampler(4, 5, np.random.default_rng(0))


def test_the_state_of_another_scene_is_refused() -> None:
    state = BatchSampler(4, 2, np.random.default_rng(0)).state()
    with pytest.raises(ValueError, match="expected a sampler of the scene's 6 views"):
        BatchSampler(6, 2, np.random.default_rng(0)).restore(state)
