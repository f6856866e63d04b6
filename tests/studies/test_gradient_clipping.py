"""Gradient clipping: Adam with clipping, the recorded norms, the verdicts."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from builders import generator, off_centre_camera, random_gaussians
from tiny import tiny_config, tiny_scene

from pipeline.config.train_schema import LearningRates
from pipeline.model.model import Model
from pipeline.presentation.seed_statistics import TOO_FEW_SEEDS
from pipeline.studies.gradient_clipping.clipping_adam import ClippingAdam, squared_norms
from pipeline.studies.gradient_clipping.table import spike, verdict
from pipeline.studies.gradient_clipping.training_runs import CASES, Outcome, study_config, train_case, with_lr_factor
from pipeline.training.optimiser import Adam
from pipeline.training.schedule import learning_rates
from rasterizer import Gradients, Rasterizer, Request

RATES = learning_rates(1.0, 0.0, LearningRates(), extent=1.0)


def model_and_gradients() -> tuple[Model, Gradients]:
    """A random model, and its gradients from two views."""
    g, camera = generator(31), off_centre_camera()
    gaussians = random_gaussians(300, "full", g).to(torch.float32)
    gradients, frame = Gradients.zeros_like(gaussians), Rasterizer(1)
    for time in (0.4, 0.6):
        frame.render(gaussians, Request(camera, time, 1.0))
        frame.backward(gradients, d_color=torch.randn(3, camera.height, camera.width, generator=g))
    return Model.from_gaussians(gaussians), gradients


def norm_of(gradients: Gradients) -> float:
    tensors = [*gradients.dense().values(), gradients.sh()]
    return math.sqrt(sum(t.double().square().sum().item() for t in tensors))


def test_gradient_above_threshold_is_scaled_to_it() -> None:
    model, gradients = model_and_gradients()
    before, directions = norm_of(gradients), {name: t.clone() for name, t in gradients.dense().items()}
    sh = gradients.sh().clone()
    norms, concentration = [], []
    ClippingAdam(model, 1, threshold=before / 4, norms=norms, concentration=concentration).step(gradients, RATES)
    assert (
        norms[0]["all"] == pytest.approx(before, rel=1e-6) and 0 < concentration[0] <= 1
    )  # sums over a row in float32
    # One float32 rounding for each element, a few for SH coefficients.
    for name, tensor in gradients.dense().items():
        torch.testing.assert_close(tensor, directions[name] / 4, rtol=1e-6, atol=0.0)
    torch.testing.assert_close(gradients.sh(), sh / 4, rtol=1e-5, atol=1e-6 * sh.abs().max().item())
    assert norm_of(gradients) == pytest.approx(before / 4, rel=1e-6)


def test_gradient_below_threshold_gives_plain_adam() -> None:
    (clipped, gradients), (plain, same) = model_and_gradients(), model_and_gradients()
    ClippingAdam(clipped, 1, threshold=2 * norm_of(gradients), norms=[], concentration=[]).step(gradients, RATES)
    Adam(plain, 1).step(same, RATES)
    for name, tensor in plain.parameters.items():
        assert torch.equal(clipped.parameters[name], tensor), name


def test_squared_norms_of_fields_sum_to_the_total() -> None:
    _, gradients = model_and_gradients()
    squares = squared_norms(gradients)
    assert set(squares) == {*gradients.dense(), "sh", "all"}
    assert math.sqrt(squares["all"].sum().item()) == pytest.approx(norm_of(gradients), rel=1e-6)


def test_spike_is_relative_to_preceding_norms() -> None:
    norms = np.concatenate([np.full(200, 8.0), np.full(200, 2.0)])
    assert spike(norms) == 1.0  # a drop is no spike
    norms[300] = 14.0
    assert spike(norms) == 7.0


def outcome(psnr: float) -> Outcome:
    return Outcome(psnr, {}, 0.0, 0.0)


@pytest.mark.parametrize(
    "clipped, unclipped, word",
    [
        ([26.0, 26.1, 26.2], [25.0, 25.1, 25.2], "better"),
        ([25.0, 25.1, 25.2], [26.0, 26.1, 26.2], "worse"),
        ([25.0, 25.1, 25.2], [25.0, 25.1, 25.2], "no difference shown"),
        ([25.0, 25.1, 25.2], [25.0, math.nan, 25.2], "better"),
        ([math.nan] * 3, [math.nan] * 3, "no difference shown"),
    ],
)
def test_verdict(clipped: list[float], unclipped: list[float], word: str) -> None:
    assert verdict([outcome(p) for p in clipped], [outcome(p) for p in unclipped])[1] == word


def test_one_seed_gives_no_verdict_and_no_error() -> None:
    assert verdict([outcome(26.0)], [outcome(25.0)]) == ("+1.00", TOO_FEW_SEEDS)


def test_learning_rates_are_scaled_and_their_decay_is_kept() -> None:
    cfg = study_config(CASES[0].scene, iterations=200, points=100, size=32)
    scaled, lr = with_lr_factor(cfg, 10.0).train.lr, cfg.train.lr
    assert (scaled.mean, scaled.opacity) == (10 * lr.mean, 10 * lr.opacity)
    assert (scaled.decay_start, scaled.decay_iterations) == (lr.decay_start, lr.decay_iterations)


@pytest.mark.parametrize("threshold, clipped", [(math.inf, 0.0), (0.0, 1.0)])
def test_training_run_records_every_norm(threshold: float, clipped: float) -> None:
    found = train_case(CASES[0], tiny_config(10), tiny_scene(), seed=0, threshold=threshold)
    assert found.norms["all"].shape == (10,) and found.clipped == clipped and not math.isnan(found.psnr)
