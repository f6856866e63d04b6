"""What images say of each Gaussian: against a naive sum of weights, in closed form, and what training does with it."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import torch
from tiny import TinyRun, tiny_config, tiny_scene, train_tiny

from pipeline.evidence import Evidence, MOST_VIEWS, evidence, least, prune_due, prune_unproven, views_to_ask
from pipeline.initialise import initialise
from pipeline.model import Model
from pipeline.optimiser import Adam
from pipeline.train_config import DensifyConfig, TrainConfig
from rasterizer import Frame
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


def test_the_least_are_as_many_as_fit_into_their_share():
    weight = torch.from_numpy(np.random.default_rng(0).pareto(1.0, 300).astype(np.float32))
    weight[::7] = 0.0
    for share in (0.0, 1e-3, 0.05, 0.5, 0.999):
        few = least(weight, share)
        inside, outside = weight[few].double(), weight[~few].double()
        total = weight.double().sum()
        assert inside.sum() <= share * total < inside.sum() + outside.min()  # one more would not fit
        assert len(inside) == 0 or inside.max() <= outside.min()
        assert few[weight == 0].all()
    assert least(torch.ones(10), 0.35).tolist() == [True] * 3 + [False] * 7  # ties by index


def test_images_change_by_no_more_than_the_share_left_out():
    scene, cfg = tiny_scene(views=3), tiny_config()
    model = initialise(scene, cfg, np.random.default_rng(0))
    noise = np.random.default_rng(1).normal(size=len(model))
    model.parameters["opacity_logit"] += torch.from_numpy(noise).float().view_as(model.parameters["opacity_logit"])
    found, before = found_in(model, scene, cfg), shown(model, scene, cfg)
    share, count = 0.2, len(model)
    assert prune_unproven(Adam(model), found, DensifyConfig(leave_out=share)) > 0.2 * count
    after = shown(model, scene, cfg)
    # What a pixel loses of those that went it gains of those behind: weights and the background's sum to one. So it
    # changes by no more than their weight × the range of colours; 1 + 1e-3 for sums in float32 and what ends a ray.
    colors = torch.cat([image.flatten() for image in before + after])
    change = sum(float((a - b).abs().amax(dim=0).sum()) for a, b in zip(after, before))
    bound = share * float(found.weight.sum()) * float(colors.max() - colors.min())
    assert 0.01 * bound < change < (1 + 1e-3) * bound


def shown(model, scene, cfg) -> list[torch.Tensor]:
    """Its images of the training views, (3, h, w) each."""
    requests = [Request(v.camera, v.time, scene.duration, near=cfg.scene.near) for v in scene.train]
    return [Frame(threads=1).render(model.gaussians(), request).color.clone() for request in requests]


def test_nothing_is_left_out_of_the_sphere_nor_what_was_not_asked_about():
    rules = DensifyConfig(leave_out=0.2)
    model = initialise(tiny_scene(), tiny_config(), np.random.default_rng(0))
    count = len(model)
    found = Evidence(torch.where(torch.arange(count) < count // 2, 0.0, 1.0), (torch.arange(count) % 2).float())
    lost = torch.arange(count) < count // 2 + int(0.2 * (count - count // 2))  # those of no weight and a fifth of it
    assert prune_unproven(Adam(model.copy()), found, rules) == int(lost.sum())
    assert prune_unproven(Adam(model.copy()), found, rules, all_asked=False) == int((lost & (found.views > 0)).sum())
    sphere = Model.restored(model.kind, model.state() | {"sphere": torch.ones(count, dtype=torch.bool)})
    assert prune_unproven(Adam(sphere), found, rules) == 0


def trained_with_and_without(folder: Path, **rules) -> tuple[Model, Model]:
    """After 60 iterations: with these rules of densification, and as tiny_config has them. The first is in folder/run."""
    cfg = tiny_config(60)
    cfg.train.densify = dataclasses.replace(cfg.train.densify, **rules)
    return train_tiny(folder / "run", cfg).model, train_tiny(folder / "free", tiny_config(60)).model


def test_training_leaves_out_what_makes_least(tmp_path):
    model, free = trained_with_and_without(tmp_path, leave_out=0.05, evidence_every=20)
    scene, cfg = tiny_scene(), tiny_config()
    # Each time a twentieth of the images' weight, most of it of many small ones.
    assert len(model) < 0.9 * len(free)
    idle, before = (float(least(found_in(m, scene, cfg).weight, 0.05).float().mean()) for m in (model, free))
    assert idle < before


def test_when_it_is_due():
    rules = DensifyConfig(min_views=2.0, evidence_every=100, start=150, stop=300)
    cfg = TrainConfig(iterations=580, densify=rules)
    # On after the last densification; not at 500, after which there is less than a period to go.
    assert [i for i in range(581) if prune_due(i, cfg)] == [200, 300, 400]
    alone = dataclasses.replace(cfg, densify=dataclasses.replace(rules, min_views=0.0, leave_out=0.01))
    assert [i for i in range(581) if prune_due(i, alone)] == [200, 300, 400]
    off = TrainConfig(densify=DensifyConfig(evidence_every=1))
    assert not any(prune_due(i, off) for i in range(1000))  # by default


def test_training_leaves_none_that_one_view_alone_saw(tmp_path):
    model, free = trained_with_and_without(tmp_path, min_views=1.5, evidence_every=2)
    scene, cfg = tiny_scene(), tiny_config()
    # Not quite none: what stood behind those that went is uncovered, in one view more than in another.
    few, before = (float((found_in(m, scene, cfg).views < 1.5).float().mean()) for m in (model, free))
    assert few < 0.1 * before
    pruned = [row for row in TinyRun(tmp_path / "run").rows("log.jsonl") if row["event"] == "prune"]
    assert [row["iteration"] for row in pruned] == list(range(6, 59, 2))
    assert pruned[-1]["n_gaussians"] == len(model) and sum(row["pruned"] for row in pruned) > 0
