"""Jitter of the temporal marginals: its size, when there is none, and that training is a function of the seed."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from tiny import tiny_config, tiny_scene, train_tiny

from pipeline.model.initialise import initialise
from pipeline.model.model import Model
from pipeline.training.objective.marginal_jitter import MAX_SHORT_LIVED, SAMPLE, draw_offsets, short_lived_share

SCENE = tiny_scene()
SPACING = 1 / 7  # eight views at times from 0 to 1


def model_with_short_lived(share: float, count: int = 400) -> Model:
    """`count` Gaussians, of which the first have a lifetime of half a spacing, the others of two."""
    model = initialise(SCENE, tiny_config(init_points=count), np.random.default_rng(0))
    short = torch.arange(count) < share * count
    model.parameters["log_scale"][:, 3] = torch.where(short, math.log(0.5 * SPACING), math.log(2 * SPACING))
    return model


def test_offsets_are_uniform_within_multiples_of_the_time_spacing():
    model = model_with_short_lived(0.0)
    offsets = np.array(draw_offsets(10_000, 1.5, model, SCENE, np.random.default_rng(0))) / (1.5 * SPACING)
    assert np.abs(offsets).max() <= 1 + 1e-12
    # Standard deviation of a uniform variable in ±1: 1/√3; of its mean over 10,000: 0.006.
    assert abs(offsets.mean()) < 0.03 and offsets.std() == pytest.approx(3**-0.5, rel=0.03)


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_short_lived_gaussians_turn_jitter_off(factor: float):
    model = model_with_short_lived(factor * MAX_SHORT_LIVED)
    assert short_lived_share(model, SCENE) == pytest.approx(factor * MAX_SHORT_LIVED, abs=0.01)
    offsets = draw_offsets(8, 2.0, model, SCENE, np.random.default_rng(0))
    assert any(offsets) == (factor < 1)


def test_the_share_of_many_gaussians_is_that_of_a_sample_of_all_rows():
    count = 10 * SAMPLE
    model = model_with_short_lived(0.25, count)
    rows = torch.randperm(count, generator=torch.Generator().manual_seed(0))
    model.parameters["log_scale"] = model.parameters["log_scale"][rows]
    # Standard deviation √(0.25 · 0.75 / 2000) = 0.01.
    assert short_lived_share(model, SCENE) == pytest.approx(0.25, abs=0.04)


def test_training_with_jitter_is_a_function_of_the_seed(tmp_path):
    plain = train_tiny(tmp_path / "plain").model
    runs = [train_tiny(tmp_path / f"{i}", tiny_config(marginal_jitter=2.0)).model for i in range(2)]
    other = train_tiny(tmp_path / "seed", replace(tiny_config(marginal_jitter=2.0), seed=1)).model
    first, second = (run.parameters["mean"] for run in runs)
    assert torch.equal(first, second)
    assert not torch.equal(first, plain.parameters["mean"]) and not torch.equal(first, other.parameters["mean"])


def test_a_model_without_motion_is_not_jittered(tmp_path):
    """Its Gaussians cannot follow anything: the jitter would only blur."""
    changed = [replace(tiny_config(**keys), ablation=replace(tiny_config().ablation, rotation_4d=False))
               for keys in ({}, {"marginal_jitter": 2.0})]  # fmt: skip
    plain, jittered = (train_tiny(tmp_path / f"{i}", cfg).model for i, cfg in enumerate(changed))
    assert all(torch.equal(plain.parameters[name], jittered.parameters[name]) for name in plain.parameters)
