"""Jitter of the temporal marginals: its size, and that training with it is a function of the seed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from tiny import tiny_config, tiny_scene, train_tiny

from pipeline.training.objective.marginal_jitter import draw_offsets


def test_offsets_are_uniform_within_a_multiple_of_the_spacing_of_the_training_times():
    scene = tiny_scene()
    times = sorted({view.time for view in scene.train})
    spacing = (times[-1] - times[0]) / (len(times) - 1)
    assert scene.frame_spacing == pytest.approx(spacing, rel=0.2)  # the duration may reach beyond the views
    offsets = np.array(draw_offsets(10_000, 1.5, scene, np.random.default_rng(0))) / (1.5 * scene.frame_spacing)
    assert np.abs(offsets).max() <= 1
    # Standard deviation of a uniform variable in ±1: 1/√3; of its mean over 10,000: 0.006.
    assert abs(offsets.mean()) < 0.03 and offsets.std() == pytest.approx(3**-0.5, rel=0.03)


def test_training_with_jitter_is_a_function_of_the_seed(tmp_path):
    plain = train_tiny(tmp_path / "plain").model
    runs = [train_tiny(tmp_path / f"{i}", tiny_config(marginal_jitter=2.0)).model for i in range(2)]
    other = train_tiny(tmp_path / "seed", replace(tiny_config(marginal_jitter=2.0), seed=1)).model
    first, second = (run.parameters["mean"] for run in runs)
    assert torch.equal(first, second)
    assert not torch.equal(first, plain.parameters["mean"]) and not torch.equal(first, other.parameters["mean"])
