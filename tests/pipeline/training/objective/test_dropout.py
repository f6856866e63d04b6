"""Dropout of Gaussians: against a model that does not have them, and its share."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from tiny import TinyRun, random_model, tiny_config, tiny_scene, train_tiny

from pipeline.data.training_views import TrainingViews
from pipeline.model.initialise import initialise
from pipeline.model.model import Model, ModelKind
from pipeline.model.render import ImageGradient, backward, render
from pipeline.training.objective.dropout import draw_dropped, short_lived, without
from pipeline.training.state import start
from pipeline.training.step import draw_batch
from rasterizer import Gradients, Rasterizer, Request


def test_the_view_is_that_of_a_model_without_them_and_so_are_the_gradients():
    scene, cfg = tiny_scene(), tiny_config()
    model = initialise(scene, cfg, np.random.default_rng(0))
    dropped = draw_dropped(len(model), 0.4, np.random.default_rng(1))
    smaller = Model(model.kind, {name: tensor[~dropped] for name, tensor in model.parameters.items()})
    view = scene.train[3]
    request = Request(view.camera, view.time, scene.duration, scene.background)
    d_image = torch.randn(3, 32, 32, generator=torch.Generator().manual_seed(2))
    found = []
    for each in (without(model, dropped), smaller):
        rasterizer, gradients = Rasterizer(threads=1), Gradients.zeros_like(each.gaussians())
        rendered = render(rasterizer, each, request)
        backward(rasterizer, each, rendered, ImageGradient(image=d_image), gradients)
        found.append((rendered.image, gradients))
    (image, gradients), (expected_image, expected) = found
    assert torch.equal(image, expected_image)
    for name in ("mean", "log_scale", "quat_left", "quat_right", "opacity_logit"):
        tensor = getattr(gradients, name)
        assert torch.equal(tensor[~dropped], getattr(expected, name))
        assert not tensor[dropped].any()
    assert not torch.equal(model.parameters["opacity_logit"], without(model, dropped).parameters["opacity_logit"])


def test_each_gaussian_is_dropped_with_the_probability():
    rng = np.random.default_rng(0)
    dropped = torch.stack([draw_dropped(500, 0.2, rng) for _ in range(1000)]).float()
    # Standard deviations of a mean: √(0.16 / 500,000) = 6e-4 over all; √(0.16 / 1000) = 0.013 for one of 500.
    assert abs(dropped.mean().item() - 0.2) < 0.003
    assert (dropped.mean(dim=0) - 0.2).abs().max() < 0.06


def test_short_lived_gaussians_are_those_with_a_smaller_temporal_scale():
    model = random_model(ModelKind("full", 0, 0), count=4)
    model.parameters["log_scale"][:, 3] = torch.tensor([0.1, 0.19, 0.21, 3.0]).log()
    assert short_lived(model, 0.2).tolist() == [True, True, False, False]


def test_a_static_model_has_no_short_lived_gaussians():
    assert not short_lived(random_model(ModelKind("static", 0, 0)), 100.0).any()


def test_late_dropout_spares_long_lived_gaussians(tmp_path):
    scene, cfg = tiny_scene(), tiny_config(iterations=10, dropout=0.5, dropout_until=0.5)
    state = start(initialise(scene, cfg, np.random.default_rng(0)), scene, cfg, TinyRun(tmp_path))
    short = torch.arange(len(state.model)) % 2 == 0
    state.model.parameters["log_scale"][:, 3] = (torch.where(short, 0.19, 0.21) * scene.duration).log()
    shares = []
    for _ in range(10):
        phase = state.begin_iteration(scene, cfg)
        drawn = torch.stack([v.dropped for v in draw_batch(state, TrainingViews(scene.train), phase, scene, cfg)])
        shares.append((drawn[:, short].float().mean().item(), drawn[:, ~short].float().mean().item()))
    of_short, of_long = zip(*shares, strict=True)
    assert all(share > 0 for share in of_short)
    assert [share > 0 for share in of_long] == [True] * 5 + [False] * 5


def test_training_with_dropout_is_a_function_of_the_seed(tmp_path):
    plain = train_tiny(tmp_path / "plain").model
    runs = [train_tiny(tmp_path / f"{i}", tiny_config(dropout=0.3)).model for i in range(2)]
    other = train_tiny(tmp_path / "seed", replace(tiny_config(dropout=0.3), seed=1)).model
    first, second = (run.parameters["mean"] for run in runs)
    assert torch.equal(first, second)
    assert not torch.equal(first, plain.parameters["mean"]) and not torch.equal(first, other.parameters["mean"])


def test_dropout_that_never_begins_changes_nothing(tmp_path):
    def trained(name: str, **changes: float) -> torch.Tensor:
        return train_tiny(tmp_path / name, tiny_config(init_time_scale=2.0, **changes)).model.parameters["mean"]

    plain, whole = trained("plain"), trained("whole", dropout=0.3)
    assert torch.equal(trained("never", dropout=0.3, dropout_until=0.0), plain)
    half = trained("half", dropout=0.3, dropout_until=0.5)
    assert half.shape != whole.shape or not torch.equal(half, whole)
    assert half.shape != plain.shape or not torch.equal(half, plain)
