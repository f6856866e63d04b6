"""The released program's rigid loss against its definition, a naive loop over Gaussians and their neighbours."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from builders import random_gaussians
from tiny import TinyRun, tiny_config, tiny_scene

from pipeline.config.train_schema import RegularizationConfig
from pipeline.data.training_views import TrainingViews
from pipeline.model.initialise import initialise
from pipeline.training.objective.objective import Objective
from pipeline.training.objective.released_rigid import FIELDS, released_rigid_loss
from pipeline.training.state import start
from pipeline.training.step import draw_batch, render_batch
from rasterizer.covariance import rotation_4d

DURATION = 1.0


@pytest.fixture
def tensors() -> dict[str, torch.Tensor]:
    gaussians = random_gaussians(60, "full", torch.Generator().manual_seed(7))  # float64
    return {name: getattr(gaussians, name) for name in ("mean", "log_scale", "quat_left", "quat_right")}


@pytest.mark.parametrize("neighbours", [20, 5, 1, 100])
def test_the_release_compares_all_gaussians_at_their_means(tensors, neighbours):
    """Its formula: sum of exp(-100 d) |u_i - u_j| / (k N) over the k nearest of each, itself included."""
    truth = {name: t.clone().requires_grad_() for name, t in tensors.items()}
    rotation = rotation_4d(truth["quat_left"], truth["quat_right"])
    covariance = rotation @ torch.diag_embed((2 * truth["log_scale"]).exp()) @ rotation.transpose(1, 2)
    step = covariance[:, :3, 3] / covariance[:, 3, 3:] * 0.1 * DURATION
    distance = torch.cdist(tensors["mean"][:, :3], tensors["mean"][:, :3])
    expected = torch.zeros((), dtype=torch.float64)
    for i, row in enumerate(distance):
        for j in row.argsort()[:neighbours].tolist():
            if j != i:  # its own difference is zero, of which the norm has no gradient
                expected = expected + math.exp(-100 * float(row[j])) * (step[j] - step[i]).norm()
    expected = expected / (neighbours * len(step))

    ours = {name: t.clone().requires_grad_() for name, t in tensors.items()}
    found = released_rigid_loss(ours, DURATION, neighbours)
    assert found.item() == pytest.approx(expected.item(), rel=1e-9)
    if neighbours > 1:
        found.backward()
        expected.backward()
        for name in ("log_scale", "quat_left", "quat_right"):
            torch.testing.assert_close(ours[name].grad, truth[name].grad, rtol=1e-7, atol=1e-12)
        assert ours["mean"].grad is None


def test_the_release_has_it_once_in_a_batch_and_as_its_mean(tmp_path):
    """The gradient of an iteration: that of the images, and that of the term itself, whatever the size of the batch."""
    found = {}
    for weight in (0.0, 1e5):  # the means of the tiny scene are far apart
        rules = RegularizationConfig(rigid_released=weight)
        cfg = tiny_config(batch=3, regularization=rules)
        scene = tiny_scene()
        state = start(initialise(scene, cfg, np.random.default_rng(0)), scene, cfg, TinyRun(tmp_path))
        state.model.parameters["quat_left"] += 0.3 * torch.randn(
            state.model.parameters["quat_left"].shape, generator=torch.Generator().manual_seed(1)
        )
        phase = state.begin_iteration(scene, cfg)
        drawn = draw_batch(state, TrainingViews(scene.train), phase, scene, cfg)
        batch = render_batch(state, drawn, phase, Objective(scene, cfg, 1), scene, cfg)
        found[weight] = batch.loss, state.gradients.quat_left.double().clone()
    fields = {n: p.double().requires_grad_() for n, p in state.model.parameters.items() if n in FIELDS}
    loss = 1e5 * released_rigid_loss(fields, scene.duration, 20)
    loss.backward()
    gradient = fields["quat_left"].grad
    # Differences of float32 sums
    assert found[1e5][0] - found[0.0][0] == pytest.approx(loss.item(), rel=1e-4)
    torch.testing.assert_close(
        found[1e5][1] - found[0.0][1], gradient, rtol=1e-3, atol=1e-5 * float(gradient.abs().max())
    )
