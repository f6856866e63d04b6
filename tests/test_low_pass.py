"""The temporal low-pass against its definition, and its gradient against autograd through the definition."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from builders import random_gaussians
from tiny import tiny_config, tiny_scene, train_tiny

from pipeline.initialise import initialise
from pipeline.low_pass import carry_back, low_passed
from pipeline.model import Model
from rasterizer import Gradients
from rasterizer.reference import scaled_axes

SIGMA = 0.3


@pytest.fixture
def gaussians():
    return random_gaussians(60, "separable", torch.Generator().manual_seed(2))  # float64


def test_variance_grows_by_sigma_squared_and_the_sum_over_time_stays(gaussians):
    wide = low_passed(gaussians, SIGMA)
    before, after = (scaled_axes(g)[:, 3].square().sum(dim=1) for g in (gaussians, wide))
    torch.testing.assert_close(after, before + SIGMA**2, rtol=1e-12, atol=0)  # float64 rounding
    # ∫ α p(t) dt = α √(2π Σtt)
    torch.testing.assert_close(wide.opacity_logit.sigmoid() * after.sqrt(),
                               gaussians.opacity_logit.sigmoid() * before.sqrt(), rtol=1e-12, atol=0)


def test_what_lives_long_is_left_alone(gaussians):
    slow = replace(gaussians, log_scale=gaussians.log_scale + 12.0)
    wide = low_passed(slow, SIGMA)
    for name, tensor in wide.tensors().items():
        torch.testing.assert_close(tensor, getattr(slow, name), rtol=1e-8, atol=1e-8)  # (σ/st)² is below 1e-8


def test_the_gradient_is_carried_back(gaussians):
    stored = replace(gaussians, log_scale=gaussians.log_scale.requires_grad_(),
                     opacity_logit=gaussians.opacity_logit.requires_grad_())
    wide = low_passed(stored, SIGMA)
    rng = torch.Generator().manual_seed(3)
    upstream = [torch.randn(t.shape, generator=rng, dtype=t.dtype) for t in (wide.log_scale, wide.opacity_logit)]
    truth = torch.autograd.grad((wide.log_scale, wide.opacity_logit), (stored.log_scale, stored.opacity_logit), upstream)
    gradients = Gradients.zeros_like(gaussians)
    gradients.log_scale.copy_(upstream[0])
    gradients.opacity_logit.copy_(upstream[1])
    with torch.no_grad():
        carry_back(gradients, stored, SIGMA)
    for mine, theirs in zip((gradients.log_scale, gradients.opacity_logit), truth):
        torch.testing.assert_close(mine, theirs, rtol=1e-10, atol=1e-12)  # float64, the same formula another way


def test_opaque_and_transparent_gaussians_keep_finite_gradients(gaussians):
    for logit in (-80.0, -30.0, 30.0, 80.0):  # float32: sigmoid(30) is 1
        stored = type(gaussians)(**{"quat_right": None, **{n: t.float() for n, t in gaussians.tensors().items()}})
        stored = replace(stored, opacity_logit=torch.full((60,), logit))
        gradients = Gradients.zeros_like(stored)
        gradients.log_scale.fill_(1.0)
        gradients.opacity_logit.fill_(1.0)
        carry_back(gradients, stored, SIGMA)
        assert gradients.all_finite() and torch.isfinite(low_passed(stored, SIGMA).opacity_logit).all()


def test_a_model_remembers_its_low_pass():
    model = initialise(tiny_scene(), tiny_config(), np.random.default_rng(0))
    model.low_pass = SIGMA
    again = Model.restored(model.kind, model.state())
    assert again.low_pass == SIGMA
    assert torch.equal(again.gaussians().log_scale, low_passed(model.stored(), SIGMA).log_scale)


def test_training_goes_through_it(tmp_path):
    result = train_tiny(tmp_path / "run", tiny_config(20, low_pass=2.0))
    assert result.model.low_pass == pytest.approx(2 / 7)  # eight moments a duration
    assert result.best_model.low_pass == result.model.low_pass
