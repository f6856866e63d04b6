"""Checkpoints: exact round trip, atomic writes, and errors for invalid files."""

from __future__ import annotations

import json
import os

import numpy as np
import pytest
import torch
from builders import random_gaussians
from tiny import random_model

from pipeline.model.environment_map import EnvironmentMap
from pipeline.model.model import Model, ModelKind
from pipeline.model.transformed import in_velocities
from pipeline.training import checkpoint
from pipeline.training.checkpoint import Checkpoint
from pipeline.training.density.statistics import Statistics
from pipeline.training.objective.neighbours import Neighbours
from pipeline.training.reporting import Spent
from rasterizer.covariance import scaled_axes

RNG_STATE = json.dumps(np.random.default_rng(4).bit_generator.state)


def example(iteration: int = 7, **changes) -> Checkpoint:
    model = random_model(ModelKind("full", 2, 3))
    moments = tuple({name: torch.rand_like(t) for name, t in model.parameters.items()} for _ in range(2))
    values = dict(
        iteration=iteration,
        spent=Spent(0.1 + 0.2, 0.7),
        seed=3,
        model=model,
        step_count=iteration,
        moments=moments,
        shared_moments={},
        statistics={name: torch.rand(7) for name in Statistics.FIELDS},
        sampler={"order": np.arange(5)[::-1].copy(), "position": 2, "generator": RNG_STATE},
        split_rng=torch.Generator().manual_seed(5).get_state(),
        best={"psnr": 1 / 3, "iteration": 5},
        best_model=random_model(model.kind),
        neighbours=Neighbours(torch.randint(7, (7, 8), dtype=torch.int32), 0.1),
    )
    return Checkpoint(**(values | changes))


def assert_same(a: dict, b: dict) -> None:
    assert a.keys() == b.keys()
    assert all(torch.equal(a[name], b[name]) for name in a)


def test_round_trip_is_exact(tmp_path) -> None:
    path, saved = tmp_path / checkpoint.FILE_NAME, example()
    checkpoint.save(path, saved)
    loaded = checkpoint.load(path)
    for name in ("iteration", "spent", "seed", "step_count", "best"):
        assert getattr(loaded, name) == getattr(saved, name), name
    assert loaded.model.kind == saved.model.kind
    assert_same(loaded.model.parameters, saved.model.parameters)
    assert_same(loaded.best_model.parameters, saved.best_model.parameters)
    for a, b in zip(loaded.moments, saved.moments):
        assert_same(a, b)
    assert_same(loaded.statistics, saved.statistics)
    assert np.array_equal(loaded.sampler["order"], saved.sampler["order"])
    assert (loaded.sampler["position"], loaded.sampler["generator"]) == (2, RNG_STATE)
    assert torch.equal(loaded.split_rng, saved.split_rng)
    assert torch.equal(loaded.neighbours.index, saved.neighbours.index)
    assert loaded.neighbours.spacing == saved.neighbours.spacing
    assert [p.name for p in tmp_path.iterdir()] == [checkpoint.FILE_NAME], "no temporary file left"


def test_round_trip_of_background_models(tmp_path) -> None:
    """The sphere label, the environment map and its moments, of the model and of the best one."""
    kind = ModelKind("full", 2, 3)
    models = [random_model(kind) for _ in range(2)]
    for model in models:
        model.sphere, model.environment_map = torch.rand(7) < 0.5, EnvironmentMap(torch.rand(3, 4, 8))
    moments = torch.rand(3, 4, 8), torch.rand(3, 4, 8)
    checkpoint.save(
        tmp_path / "c", example(model=models[0], best_model=models[1], shared_moments={"environment": moments})
    )
    loaded = checkpoint.load(tmp_path / "c")
    assert_same(loaded.model.state(), models[0].state())
    assert_same(loaded.best_model.state(), models[1].state())
    assert all(map(torch.equal, loaded.shared_moments["environment"], moments))
    assert_same(checkpoint.load_model(tmp_path / "c").state(), models[0].state())


def test_equal_checkpoints_have_equal_bytes(tmp_path) -> None:
    torch.manual_seed(0)
    saved = example()
    checkpoint.save(tmp_path / "a", saved)
    checkpoint.save(tmp_path / "b", saved)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_round_trip_without_best(tmp_path) -> None:
    checkpoint.save(tmp_path / "c", example(best=None, best_model=None, neighbours=None))
    loaded = checkpoint.load(tmp_path / "c")
    assert loaded.best is None and loaded.best_model is None and loaded.neighbours is None
    assert loaded.shared_moments == {} and loaded.model.background_model == "none"


def test_load_model(tmp_path) -> None:
    saved = example()
    checkpoint.save(tmp_path / "c", saved)
    assert_same(checkpoint.load_model(tmp_path / "c").parameters, saved.model.parameters)


def test_what_was_trained_in_velocities_is_read_in_rotations(tmp_path) -> None:
    """By all but the training itself, which continues in velocities."""
    gaussians = random_gaussians(7, "full", torch.Generator().manual_seed(1)).to(torch.float32)
    rotations = Model.from_gaussians(gaussians)
    model = in_velocities(rotations)
    moments = tuple({name: torch.zeros_like(t) for name, t in model.parameters.items()} for _ in range(2))
    checkpoint.save(tmp_path / "c", example(model=model, moments=moments, best=None, best_model=None))
    assert checkpoint.load(tmp_path / "c").model.kind.motion == "velocity"
    loaded = checkpoint.load_model(tmp_path / "c")
    assert loaded.kind == rotations.kind
    covariances = [axes @ axes.mT for axes in (scaled_axes(model.gaussians()) for model in (rotations, loaded))]
    # float32 parameters twice; a covariance is at most 1 here
    torch.testing.assert_close(*covariances, rtol=0, atol=1e-5)


@pytest.mark.parametrize("dies_in", ["save_file", "fsync", "replace"])
def test_an_interrupted_write_keeps_the_old_checkpoint(tmp_path, monkeypatch, dies_in: str) -> None:
    path = tmp_path / checkpoint.FILE_NAME
    checkpoint.save(path, example(iteration=7))

    def die(*_, **__) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(checkpoint if dies_in == "save_file" else os, dies_in, die)
    with pytest.raises(KeyboardInterrupt):
        checkpoint.save(path, example(iteration=8))
    monkeypatch.undo()
    assert checkpoint.load(path).iteration == 7
    checkpoint.save(path, example(iteration=9))
    assert checkpoint.load(path).iteration == 9


@pytest.mark.parametrize("content", [b"", b"not a checkpoint", None])
def test_an_invalid_file_is_refused_in_one_line_with_its_name(tmp_path, content: bytes | None) -> None:
    path = tmp_path / checkpoint.FILE_NAME
    checkpoint.save(path, example())
    path.write_bytes(path.read_bytes()[:-100] if content is None else content)
    with pytest.raises(ValueError, match=f"{checkpoint.FILE_NAME}: expected a checkpoint") as error:
        checkpoint.load(path)
    assert "\n" not in str(error.value)
