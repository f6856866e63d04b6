"""The rigid loss against its definition, a naive loop over Gaussians and their neighbours."""

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
from pipeline.model.model import Model
from pipeline.model.transformed import in_velocities
from pipeline.training.objective import model_terms
from pipeline.training.objective.model_terms import (
    FALLOFF,
    FIELDS,
    MIN_MARGINAL,
    VELOCITY_STEP,
    Rigid,
    add_gradient,
    released_rigid_loss,
    rigid_loss,
)
from pipeline.training.objective.objective import Objective
from pipeline.training.state import start
from pipeline.training.step import draw_batch, render_batch
from rasterizer import Gradients
from rasterizer.covariance import rotation_4d

TIME, DURATION = 0.4, 1.0
NEIGHBOURS = 20


@pytest.fixture
def tensors() -> dict[str, torch.Tensor]:
    gaussians = random_gaussians(60, "full", torch.Generator().manual_seed(7))  # float64
    return {name: getattr(gaussians, name) for name in ("mean", "log_scale", "quat_left", "quat_right")}


def naive(mean, log_scale, quat_left, quat_right, neighbours=NEIGHBOURS) -> torch.Tensor:
    """With the full Σ, and the distances of all pairs."""
    rotation = rotation_4d(quat_left, quat_right)
    covariance = rotation @ torch.diag_embed((2 * log_scale).exp()) @ rotation.transpose(1, 2)
    moving = []
    for mu, sigma in zip(mean, covariance):
        dt, velocity = TIME - mu[3], sigma[:3, 3] / sigma[3, 3]
        if math.exp(-0.5 * float(dt.detach()) ** 2 / float(sigma[3, 3].detach())) > MIN_MARGINAL:
            moving.append(((mu[:3] + velocity * dt).detach(), velocity * VELOCITY_STEP * DURATION))
    terms = []
    for position, step in moving:
        others = [(float((position - p).norm()), s) for p, s in moving if p is not position]
        others.sort(key=lambda pair: pair[0])
        terms += [math.exp(-FALLOFF * d**2) * (s - step).norm() for d, s in others[:neighbours]]
    return torch.stack(terms).mean()


def test_the_loss_equals_its_definition(tensors):
    # Both in float64; 1e-20 under the root changes a speed of 1e-5 by 5e-16, and sums differ in order.
    assert rigid_loss(tensors, TIME, DURATION, NEIGHBOURS).item() == pytest.approx(naive(**tensors).item(), rel=1e-9)


def test_the_gradient_equals_that_of_the_definition(tensors):
    ours = {name: t.clone().requires_grad_() for name, t in tensors.items()}
    truth = {name: t.clone().requires_grad_() for name, t in tensors.items()}
    rigid_loss(ours, TIME, DURATION, NEIGHBOURS).backward()
    naive(**truth).backward()
    for name in ("log_scale", "quat_left", "quat_right"):  # the mean enters only through detached positions and p(t)
        torch.testing.assert_close(ours[name].grad, truth[name].grad, rtol=1e-7, atol=1e-12)


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
        rules = RegularizationConfig(rigid=weight, rigid_released=True)
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


@pytest.mark.parametrize("neighbours", [NEIGHBOURS, 8])
def test_it_is_added_to_the_gradients_with_its_weight(tensors, neighbours):
    gaussians = random_gaussians(60, "full", torch.Generator().manual_seed(7))
    model = Model.from_gaussians(type(gaussians)(**{name: t.float() for name, t in gaussians.tensors().items()}))
    gradients = Gradients.zeros_like(model.gaussians())
    gradients.quat_left.fill_(0.5)
    loss = add_gradient(gradients, model, lambda fields: 3 * rigid_loss(fields, TIME, DURATION, neighbours))
    truth = {name: t.clone().requires_grad_() for name, t in tensors.items()}
    expected = 3 * naive(**truth, neighbours=neighbours)
    expected.backward()
    # float32 against float64: errors of 6e-8 of the largest velocity, whose differences are as large as it
    assert loss == pytest.approx(expected.item(), rel=1e-5)
    for name in tensors:
        grad = torch.zeros_like(truth[name]) if truth[name].grad is None else truth[name].grad
        mine = getattr(gradients, name).double() - (0.5 if name == "quat_left" else 0.0)
        torch.testing.assert_close(mine, grad, rtol=1e-4, atol=1e-5 * float(grad.abs().max()) + 1e-7)


def test_it_is_the_same_for_the_same_gaussians_in_velocities(tensors):
    gaussians = random_gaussians(60, "full", torch.Generator().manual_seed(7))
    model = in_velocities(Model.from_gaussians(gaussians.to(torch.float32)))
    fields = {name: p.double() for name, p in model.parameters.items() if name in FIELDS}
    # float32 parameters: 6e-8 of the largest velocity, whose differences are as large as it
    found = rigid_loss(fields, TIME, DURATION, NEIGHBOURS).item()
    assert found == pytest.approx(naive(**tensors).item(), rel=1e-5)
    gradients = Gradients.zeros_like(model.gaussians())
    add_gradient(gradients, model, lambda fields: 3 * rigid_loss(fields, TIME, DURATION, NEIGHBOURS))
    velocity = fields["velocity"].requires_grad_()
    (3 * rigid_loss(fields, TIME, DURATION, NEIGHBOURS)).backward()
    torch.testing.assert_close(gradients.velocity.double(), velocity.grad, rtol=1e-4, atol=1e-7)


def test_equal_velocities_have_no_loss(tensors):
    same = {name: t[:1].expand(30, -1).clone() for name, t in tensors.items() if name != "mean"}
    mean = tensors["mean"][:30].clone()
    mean[:, 3] = TIME
    # 1e-10: the root of 1e-20, which keeps the gradient finite.
    assert rigid_loss({"mean": mean, **same}, TIME, DURATION, NEIGHBOURS).item() <= 1.01e-10


def test_it_takes_every_32nd_training_view(tmp_path, monkeypatch):
    """Batches of three: 32, 64, 96 are of different places in them."""
    cfg, scene = tiny_config(batch=3, regularization=RegularizationConfig(rigid=1.0)), tiny_scene()
    views, rigid = TrainingViews(scene.train), Rigid(1.0, scene.duration, 1)
    monkeypatch.setattr(model_terms, "add_gradient", lambda *arguments: 1.0)
    state = start(initialise(scene, cfg, np.random.default_rng(0)), scene, cfg, TinyRun(tmp_path))
    found = []
    for _ in range(33):
        phase = state.begin_iteration(scene, cfg)
        drawn = draw_batch(state, views, phase, scene, cfg)
        found += [rigid.add(state.gradients, state.model, view) > 0 for view in drawn]
    assert found == [i % 32 == 0 for i in range(1, 100)]
