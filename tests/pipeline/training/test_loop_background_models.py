"""Training of the background models: they learn what is far away, and do not change once they are frozen."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from test_loop import assert_same_state, batch_losses
from tiny import TinyRun, tiny_config, tiny_scene, train_tiny

from datasets.scene import Scene
from pipeline.config.train_schema import DensifyConfig
from pipeline.data.training_views import target_of
from pipeline.model.environment_map import EnvironmentMap
from pipeline.model.initialise import initialise
from pipeline.training import checkpoint, finite_checks, schedule, state
from pipeline.training.objective.objective import Objective
from pipeline.training.objective.terms import DrawnView
from pipeline.training.schedule import phase
from pipeline.training.state import start
from rasterizer import Gradients

BACKGROUND_MODELS = ("sphere", "envmap")
pytestmark = pytest.mark.usefixtures("small_backgrounds")


def final(path: Path) -> checkpoint.Checkpoint:
    return checkpoint.load(path / checkpoint.FILE_NAME)


@pytest.mark.parametrize("optimiser", ["adam", "sparse_adam"])
def test_a_frozen_sphere_does_not_change(tmp_path, optimiser: str) -> None:
    """Frozen after 20 of 60 iterations; densification at 30 and 40, an opacity reset at 25."""
    for iterations in (20, 60):
        train_tiny(tmp_path / str(iterations), tiny_config(iterations, "sphere", optimiser=optimiser))
    at_20, at_60 = (final(tmp_path / run) for run in ("20", "60"))
    start = initialise(tiny_scene(), tiny_config(20, "sphere"), np.random.default_rng(0))
    before, after = at_20.model.sphere, at_60.model.sphere
    assert 20 < start.sphere.sum() == before.sum() == after.sum()
    for name, tensor in at_20.model.parameters.items():
        assert torch.equal(at_60.model.parameters[name][after], tensor[before]), name
        for moments_20, moments_60 in zip(at_20.moments, at_60.moments):
            assert torch.equal(moments_60[name][after], moments_20[name][before]), name
    moved = at_20.model.parameters["opacity_logit"][before] != start.parameters["opacity_logit"][start.sphere]
    assert moved.any(), "trained before it was frozen"
    others = at_20.model.parameters["opacity_logit"][~before]
    assert at_60.model.parameters["opacity_logit"][~after].max() != others.max(), "the others are still trained"


def test_a_frozen_environment_map_does_not_change(tmp_path) -> None:
    for iterations in (20, 60):
        train_tiny(tmp_path / str(iterations), tiny_config(iterations, "envmap"))
    at_20, at_60 = (final(tmp_path / run) for run in ("20", "60"))
    assert torch.equal(at_20.model.environment_map.image, at_60.model.environment_map.image)
    assert all(map(torch.equal, at_20.shared_moments["environment"], at_60.shared_moments["environment"]))
    assert at_20.model.environment_map.image.min() < 0.5, "trained on a black background before it was frozen"
    assert at_60.best_model.environment_map is not None


def waves(scene: Scene) -> Scene:
    """The scene with colours that are a function of the world direction, instead of black, behind the disc."""

    def with_waves(view):
        camera = view.camera
        y, x = np.mgrid[: camera.height, : camera.width] + 0.5
        ray = np.stack([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, np.ones_like(x)], -1)
        ray = ray @ camera.world_to_cam[:3, :3] / np.linalg.norm(ray, axis=-1, keepdims=True)  # rows: Rᵀ ray
        color = 0.5 + 0.4 * np.sin(4.0 * ray + [0.0, 1.0, 2.0])
        empty = ~view.image.any(axis=-1, keepdims=True)
        return replace(view, image=np.where(empty, np.round(255 * color).astype(np.uint8), view.image))

    return replace(scene, train=tuple(map(with_waves, scene.train)), test=tuple(map(with_waves, scene.test)))


def test_the_environment_map_learns_the_background(tmp_path, monkeypatch) -> None:
    """20 Gaussians without densification cannot."""
    keys = dict(eval_every=1000, checkpoint_every=1000, init_points=20, densify=DensifyConfig(stop=0))
    monkeypatch.setattr(schedule, "MAP_UNTIL", 150)
    monkeypatch.setattr(schedule, "MAP_LEARNING_RATE", 0.01)
    monkeypatch.setattr(state, "MAP_HEIGHT", 40)
    losses = {
        name: batch_losses(tmp_path / name, waves(tiny_scene()), tiny_config(150, name, **keys))
        for name in ("none", "envmap")
    }
    first, last = losses["envmap"]
    assert last < 0.5 * first, "noise between batches is much less than half"
    assert last < 0.5 * losses["none"][1]


@pytest.mark.parametrize("background_model", BACKGROUND_MODELS)
@pytest.mark.parametrize("stop", [14, 31])
def test_resuming_before_and_after_the_freeze(tmp_path, background_model: str, stop: int, monkeypatch) -> None:
    original, cfg = finite_checks.check_gradients, tiny_config(60, background_model)

    def die(gradients, iteration, *rest) -> None:
        original(gradients, iteration, *rest)
        if iteration == stop:
            raise KeyboardInterrupt

    train_tiny(tmp_path / "whole", cfg)
    monkeypatch.setattr(finite_checks, "check_gradients", die)
    with pytest.raises(KeyboardInterrupt):
        train_tiny(tmp_path / "stopped", cfg)
    monkeypatch.undo()
    train_tiny(tmp_path / "stopped", cfg)
    assert_same_state(tmp_path / "whole", tmp_path / "stopped")


@pytest.mark.parametrize("background_model", BACKGROUND_MODELS)
def test_bits_do_not_depend_on_the_number_of_threads(tmp_path, background_model: str) -> None:
    before = torch.get_num_threads()
    try:
        for threads in (1, 2):
            torch.set_num_threads(threads)
            train_tiny(tmp_path / str(threads), replace(tiny_config(60, background_model), threads=threads))
    finally:
        torch.set_num_threads(before)
    assert_same_state(tmp_path / "1", tmp_path / "2")


def test_a_checkpoint_with_another_background_model_is_refused(tmp_path) -> None:
    train_tiny(tmp_path, tiny_config(10, "envmap"))
    with pytest.raises(ValueError, match="and background none, found .* and background envmap"):
        train_tiny(tmp_path, tiny_config(20))


def test_an_environment_map_with_nan_is_not_written(tmp_path) -> None:
    model = train_tiny(tmp_path, tiny_config(7, "envmap")).model
    model.environment_map.image[1, 2, 3] = float("nan")
    with pytest.raises(
        finite_checks.NonFiniteError, match="iteration 5: .* NaN or Inf in the environment map; not written"
    ):
        finite_checks.check_model(model, 5)
    with pytest.raises(finite_checks.NonFiniteError, match="found nan; NaN or Inf in the environment map"):
        finite_checks.check_loss(float("nan"), 5, "train/r_0", model)


@pytest.mark.parametrize("unit, visible", [(1.0, True), (100.0, False)])
def test_the_near_plane_is_in_the_scenes_unit(unit: float, visible: bool) -> None:
    """0.2 units are 0.2 or 20 in the world; all Gaussians are nearer than 20."""
    scene, cfg = replace(tiny_scene(), unit=unit), tiny_config()
    model = initialise(scene, cfg, np.random.default_rng(0))
    view = DrawnView(target_of(scene.train[0], 1.0), phase(1.0, cfg.train, scene.extent, 3, 2))
    objective = Objective(scene, cfg, 1)
    (found,) = objective.render(model, [view])
    rendered = objective.backward(model, found, Gradients.zeros_like(model.gaussians()))
    assert (len(rendered.gradient.visible) > 0) == visible


def test_a_trained_models_map_is_kept(tmp_path) -> None:
    cfg, scene = tiny_config(24, "envmap"), tiny_scene()
    model = initialise(scene, cfg, np.random.default_rng(0))
    model.environment_map = EnvironmentMap.grey(12)
    model.environment_map.image.fill_(0.9)
    assert (start(model, scene, cfg, TinyRun(tmp_path)).model.environment_map.image == 0.9).all()
