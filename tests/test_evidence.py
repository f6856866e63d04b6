"""What images say of each Gaussian: against a naive sum of weights, in closed form, and what training does with it."""

from __future__ import annotations

import dataclasses

import numpy as np
import torch
from tiny import TinyRun, tiny_config, tiny_scene, train_tiny

from pipeline.evidence import Evidence, MOST_VIEWS, evidence, prune_due, prune_unproven, views_to_ask
from pipeline.initialise import initialise
from pipeline.model import Model
from pipeline.optimiser import Adam
from pipeline.train_config import DensifyConfig
from rasterizer.arguments import Request
from rasterizer.reference import make_splats
from rasterizer.reference_blend import blend


def found_in(model, scene, cfg) -> Evidence:
    return evidence(model, scene.train, scene, cfg, 1.0, threads=1)


def test_weights_are_those_of_the_twin_view_by_view():
    scene, cfg = tiny_scene(views=3), tiny_config()
    model = initialise(scene, cfg, np.random.default_rng(0))
    model.parameters["sh"][::2, 0] = -2.0  # black: they show nothing and hide what is behind them
    # The twin blends features linearly: one indicator a Gaussian as its feature gives the image of its weights.
    truth = torch.zeros(len(scene.train), len(model), dtype=torch.float64)
    doubles = type(model.gaussians())(**{name: tensor.double() for name, tensor in model.gaussians().tensors().items()})
    for row, view in zip(truth, scene.train):
        splats = make_splats(doubles, Request(view.camera, view.time, scene.duration, near=cfg.scene.near))
        count = len(splats.index)
        indicators = type(splats)(**{**vars(splats), "features": torch.eye(count, dtype=torch.float64)})
        row[splats.index] += blend(indicators, view.camera)[0].sum(dim=(1, 2))
    found = found_in(model, scene, cfg)
    # float32 sums over 1,024 pixels: 1e-3 of the largest covers them and a pair or two that just misses 1/255.
    assert (found.weight - truth.sum(dim=0)).abs().max() < 1e-3 * truth.sum(dim=0).max()
    solid = truth.sum(dim=0) > 1  # one pixel in all: of less, such a pair is a large part
    views = truth.sum(dim=0).square() / truth.square().sum(dim=0).clamp(min=1e-30)
    assert solid.sum() > 50
    torch.testing.assert_close(found.views[solid].double(), views[solid], rtol=1e-2, atol=0)


def test_one_view_is_one_and_as_many_alike_are_as_many():
    scene, cfg = tiny_scene(views=4, static=True), tiny_config()
    model = initialise(scene, cfg, np.random.default_rng(0))
    model.parameters["mean"][::2, 2] += 100.0  # behind the camera
    once = evidence(model, scene.train[:1], scene, cfg, 1.0, 1)
    seen = once.weight > 0
    assert seen.any() and not seen.all()
    # Exact but for one rounding of the square and of the quotient.
    torch.testing.assert_close(once.views[seen], torch.ones(int(seen.sum())), rtol=1e-6, atol=0)
    assert (once.views[~seen] == 0).all()
    thrice = evidence(model, scene.train[:1] * 3, scene, cfg, 1.0, 1)
    torch.testing.assert_close(thrice.views[seen], torch.full((int(seen.sum()),), 3.0), rtol=1e-6, atol=0)


def test_of_many_cameras_whole_moments_are_asked_and_of_one_camera_every_view():
    scene = tiny_scene(views=4)
    times, cameras = 300, 3
    def view(i, k):
        return dataclasses.replace(scene.train[0], time=i / (times - 1), name=f"{i}/{k}")
    alone = dataclasses.replace(scene, train=tuple(view(i, 0) for i in range(2 * MOST_VIEWS)))
    assert views_to_ask(alone) == list(alone.train)
    many = dataclasses.replace(scene, train=tuple(view(i, k) for i in range(times) for k in range(cameras)))
    asked = views_to_ask(many)
    chosen = {v.time for v in asked}
    assert len(asked) == cameras * len(chosen) and 0.9 * MOST_VIEWS < len(asked) <= MOST_VIEWS
    assert {0.0, 1.0} <= chosen  # spread from first to last
    assert views_to_ask(scene) == list(scene.train)


def test_what_too_few_views_saw_goes_with_its_moments_but_the_sphere_and_never_all():
    model = initialise(tiny_scene(), tiny_config(), np.random.default_rng(0))
    count = len(model)
    state = model.state() | {"sphere": torch.arange(count) < 10}
    model = Model.restored(model.kind, state)
    adam = Adam(model)
    adam.first["mean"][:, 0] = torch.arange(count)
    views = torch.where(torch.arange(count) % 2 == 0, 1.0, 2.5)
    found = Evidence(torch.ones(count), views)
    assert prune_unproven(adam, found, DensifyConfig(min_views=2.0)) == count // 2 - 5
    kept = [i for i in range(count) if i % 2 or i < 10]
    assert adam.first["mean"][:, 0].tolist() == kept
    none = Evidence(torch.ones(len(kept)), torch.ones(len(kept)))
    model.sphere = None
    assert prune_unproven(adam, none, DensifyConfig(min_views=2.0)) == 0 and len(model) == len(kept)


def test_what_no_view_saw_stays_where_not_all_were_asked():
    model = initialise(tiny_scene(), tiny_config(), np.random.default_rng(0))
    count = len(model)
    found = Evidence(torch.ones(count), torch.tensor([0.0, 1.0, 3.0, 4.0]).repeat(count // 4))
    assert prune_unproven(Adam(model.copy()), found, DensifyConfig(min_views=2.0)) == count // 2
    assert prune_unproven(Adam(model), found, DensifyConfig(min_views=2.0), all_asked=False) == count // 4


def test_when_it_is_due():
    cfg = DensifyConfig(min_views=2.0, views_every=100, start=150, stop=300)
    assert [i for i in range(501) if prune_due(i, cfg)] == [200, 300, 400, 500]  # on after the last densification
    assert not any(prune_due(i, DensifyConfig(views_every=1)) for i in range(1000))  # off by default


def test_training_leaves_none_that_one_view_alone_saw(tmp_path):
    cfg = tiny_config(60)
    cfg.train.densify.min_views, cfg.train.densify.views_every = 1.5, 20
    scene = tiny_scene()
    free = train_tiny(tmp_path / "free", tiny_config(60)).model
    model = train_tiny(tmp_path / "run", cfg).model
    # Not quite none: what stood behind those that went is uncovered, in one view more than in another.
    few, before = (float((found_in(m, scene, cfg).views < 1.5).float().mean()) for m in (model, free))
    assert few < 0.1 * before
    pruned = [row for row in TinyRun(tmp_path / "run").rows("log.jsonl") if row["event"] == "prune"]
    assert [row["iteration"] for row in pruned] == [20, 40, 60]
    assert pruned[-1]["n_gaussians"] == len(model) and pruned[0]["pruned"] > 0
