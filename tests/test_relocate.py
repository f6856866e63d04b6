"""Densification with an exact budget: the closed forms it must keep, counts, and who moves."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from tiny import tiny_config, tiny_scene

from pipeline.initialise import initialise
from pipeline.optimiser import Adam
from pipeline.relocate import NOISE_EVERY, add_noise, relocate, shared
from pipeline.train_config import DensifyConfig
from rasterizer.reference import scaled_axes


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def optimiser(opacities: torch.Tensor) -> Adam:
    """A model of 200 Gaussians with these opacities, and moments that are all 1."""
    model = initialise(tiny_scene(), tiny_config(), np.random.default_rng(0))
    model.parameters["opacity_logit"].copy_(torch.logit(opacities))
    adam = Adam(model)
    for moments in (adam.first, adam.second):
        for tensor in moments.values():
            tensor.fill_(1.0)
    return adam


@pytest.mark.parametrize("copies", [1, 2, 5, 20])
@pytest.mark.parametrize("opacity", [0.02, 0.5, 0.95])
def test_coincident_copies_look_like_the_one_they_were(opacity, copies):
    logit, factor = shared(torch.tensor([opacity], dtype=torch.float64), torch.tensor([copies]))
    each = float(torch.sigmoid(logit))
    assert 1 - (1 - each) ** copies == pytest.approx(opacity, rel=1e-9)  # at the centre, exact: rounding alone
    # And in sum along a line through it: numerically integrated, so to the integration's 1e-6.
    x = np.linspace(-12, 12, 200_001)
    together = 1 - (1 - each * np.exp(-0.5 * (x / float(factor)) ** 2)) ** copies
    assert np.trapezoid(together, x) == pytest.approx(opacity * math.sqrt(2 * math.pi), rel=1e-6)


def test_the_transparent_move_and_the_number_grows_to_the_cap():
    opacities = torch.full((200,), 0.3)
    opacities[::4] = 0.001  # 50 of them
    adam = optimiser(opacities)
    places = adam.model.parameters["mean"].clone()
    cfg = DensifyConfig(max_gaussians=215, growth=1.05)
    _, done = relocate(adam, cfg, generator())
    assert (done.cloned, done.pruned, done.total, len(adam.model)) == (60, 50, 210, 210)
    opaque = places[opacities > 0.1]
    assert torch.equal(adam.model.parameters["mean"][:150], opaque)  # they stay, in their order
    assert all((opaque == place).all(dim=1).any() for place in adam.model.parameters["mean"][150:])
    relocate(adam, cfg, generator())
    assert len(adam.model) == 215
    relocate(adam, cfg, generator())
    assert len(adam.model) == 215


def test_sources_and_copies_start_without_moments_and_the_others_keep_theirs():
    adam = optimiser(torch.full((200,), 0.3))
    before = adam.model.parameters["opacity_logit"].clone()
    relocate(adam, DensifyConfig(max_gaussians=1000, growth=1.1), generator())
    touched = adam.model.parameters["opacity_logit"][:200] != before
    assert 0 < int(touched.sum()) <= 20
    for tensor in adam.first.values():
        assert not tensor[:200][touched].any() and not tensor[200:].any()
        assert (tensor[:200][~touched] == 1).all()


def test_a_model_that_has_faded_away_is_left_alone():
    adam = optimiser(torch.full((200,), 1e-4))
    relocate(adam, DensifyConfig(), generator())
    assert len(adam.model) == 200


def test_noise_moves_the_transparent_by_their_own_covariance():
    adam = optimiser(torch.full((200,), 1e-4))
    model = adam.model
    adam.model.parameters["opacity_logit"][0] = 3.0
    axes = scaled_axes(model.gaussians()).double()
    start, rounds = model.parameters["mean"].clone(), 4000
    rng, moved = generator(1), torch.zeros(200, 4, dtype=torch.float64)
    for _ in range(rounds):
        add_noise(model, rate=1e-4, strength=10.0, generator=rng)
        moved += (model.parameters["mean"] - start).double() ** 2
        model.parameters["mean"].copy_(start)
    covariance = axes @ axes.transpose(1, 2)
    gate = 1 / (1 + math.exp(-100 * (0.005 - 1e-4)))
    truth = (gate * 1e-4 * 10.0) ** 2 * NOISE_EVERY * covariance.square().sum(dim=2)  # diagonal of Σ Σᵀ
    ratio = (moved[1:] / rounds / truth[1:]).mean()
    # The mean of 199 × 4 sample variances of 4,000 draws: 1 ± 0.0008; rounding of the mean to float32 adds below 1e-2.
    assert ratio == pytest.approx(1.0, abs=0.02)
    assert moved[0].max() == 0  # opaque: its gate is below float32's smallest step
