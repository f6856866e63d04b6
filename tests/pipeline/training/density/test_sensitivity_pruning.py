"""Pruning by sensitivity: the estimate against removing each Gaussian in turn, closed forms, and the pruning."""

from __future__ import annotations

import dataclasses
from collections import Counter

import numpy as np
import pytest
import torch
from tiny import TinyRun, tiny_config, tiny_scene, train_tiny
from tiny_film import unsynchronised_film

from pipeline.config.train_schema import DensifyConfig, TrainConfig
from pipeline.model.environment_map import EnvironmentMap
from pipeline.model.initialise import initialise
from pipeline.model.model import Model
from pipeline.training.density.sensitivity_pruning import (
    MAX_VIEWS,
    SensitivityPruning,
    image_sensitivity,
    least_sensitive,
    prune_by_sensitivity,
    scoring_views,
)
from pipeline.training.optimiser import Adam
from rasterizer import Rasterizer, Request
from rasterizer.reference import rasterize


def mean_sensitivity(model, scene, cfg, draws: int) -> torch.Tensor:
    """(N,) float64, the mean over `draws` seeds of the signs."""
    found = [
        image_sensitivity(model, scene.train, scene, cfg, 1.0, np.random.default_rng(seed), 1) for seed in range(draws)
    ]
    return torch.stack(found).double().mean(dim=0)


def random_model(scene, cfg, count: int) -> Model:
    """Random opacities from faint to nearly opaque, and random colours."""
    rng = np.random.default_rng(1)
    model = initialise(scene, cfg, np.random.default_rng(0))
    kept = torch.arange(0, len(model), len(model) // count)[:count]
    model = Model.restored(model.kind, {name: tensor[kept] for name, tensor in model.state().items()})
    model.parameters["opacity_logit"].copy_(torch.from_numpy(rng.uniform(-3, 3, size=count)))
    model.parameters["log_scale"][:, :3] += 0.7
    model.parameters["sh"][:, 0] += torch.from_numpy(rng.normal(size=(count, 3))).float()
    return model


def test_sensitivity_is_the_squared_change_of_the_images():
    """Ground truth: the float64 reference implementation renders three views without each Gaussian in turn."""
    scene, cfg = tiny_scene(views=3), tiny_config()
    model = random_model(scene, cfg, 60)
    doubles = type(model.gaussians())(**{name: tensor.double() for name, tensor in model.gaussians().tensors().items()})

    def images(kept) -> torch.Tensor:
        some = type(doubles)(**{name: tensor[kept] for name, tensor in doubles.tensors().items()})
        return torch.stack(
            [rasterize(some, v.camera, v.time, scene.duration, scene.background).color for v in scene.train]
        )

    everything = torch.arange(len(model))
    whole = images(everything)
    truth = torch.stack([(images(everything[everything != i]) - whole).square().sum() for i in range(len(model))])
    found = mean_sensitivity(model, scene, cfg, draws=400)
    # The square of a sum with random signs has a standard deviation of at most √2 of its mean: 0.07 after 400 draws for
    # one Gaussian (the tolerance is 4.5 of these, for sixty Gaussians), less for the sum. The estimate does not include
    # the early termination of pixels.
    above = truth > 1e-3
    assert above.sum() > 40
    torch.testing.assert_close(found[above], truth[above], rtol=0.32, atol=0)
    torch.testing.assert_close(found.sum(), truth.sum(), rtol=0.05, atol=0)


def test_a_gaussian_of_the_background_colour_has_no_sensitivity():
    scene, cfg = dataclasses.replace(tiny_scene(views=2), background=(1.0, 1.0, 1.0)), tiny_config()
    model = random_model(scene, cfg, 40)
    model.parameters["sh"].zero_()
    model.parameters["sh"][:, 0] = 0.5 / 0.28209479177387814  # white, the background
    found = mean_sensitivity(model, scene, cfg, draws=1)
    assert float(found.max()) < 1e-8  # the square of 3,072 float32 errors of 1e-7 with random signs
    model.parameters["sh"][:20, 0] = 0.0  # grey
    assert float(mean_sensitivity(model, scene, cfg, draws=1).max()) > 1


def test_a_gaussian_of_the_environment_maps_colour_has_no_sensitivity():
    scene, cfg = tiny_scene(views=2), tiny_config()
    model = random_model(scene, cfg, 40)
    model.environment_map = EnvironmentMap.grey(12)
    model.parameters["sh"].zero_()  # grey
    assert float(mean_sensitivity(model, scene, cfg, draws=1).max()) < 1e-8
    model.environment_map = None  # black
    assert float(mean_sensitivity(model, scene, cfg, draws=1).max()) > 1


def test_an_opaque_gaussian_has_the_sensitivity_of_opacity_098():
    """At alpha = 0.99 the clamp has no derivative, so the estimate uses a lower opacity."""
    scene, cfg = tiny_scene(views=2), tiny_config()
    model = random_model(scene, cfg, 1)
    model.parameters["mean"].zero_()
    model.parameters["log_scale"].fill_(-0.5)  # as large as the image
    model.parameters["opacity_logit"].fill_(3.0)
    translucent = mean_sensitivity(model, scene, cfg, draws=100)
    model.parameters["opacity_logit"].fill_(20.0)
    opaque = mean_sensitivity(model, scene, cfg, draws=100)
    # (0.98/0.953)² ± four standard deviations of a hundred draws
    assert float(opaque / translucent) == pytest.approx((0.98 / 0.9526) ** 2, rel=4 * (2 / 100) ** 0.5)


def test_sensitivity_depends_on_the_rng_and_not_on_the_number_of_threads():
    scene, cfg = tiny_scene(views=3), tiny_config()
    model = random_model(scene, cfg, 60)
    one, two = (
        image_sensitivity(model, scene.train, scene, cfg, 0.5, np.random.default_rng(5), threads) for threads in (1, 2)
    )
    assert torch.equal(one, two)
    assert not torch.equal(one, image_sensitivity(model, scene.train, scene, cfg, 0.5, np.random.default_rng(6), 1))


def test_scoring_views_are_all_views_or_all_cameras_of_evenly_spread_times():
    scene = tiny_scene(views=4)
    times, cameras = 300, 3

    def view(i, k):
        return dataclasses.replace(scene.train[0], time=i / (times - 1), name=f"{i}/{k}")

    one_camera = dataclasses.replace(scene, train=tuple(view(i, 0) for i in range(2 * MAX_VIEWS)))
    assert scoring_views(one_camera) == list(one_camera.train)
    many = dataclasses.replace(scene, train=tuple(view(i, k) for i in range(times) for k in range(cameras)))
    scoring = scoring_views(many)
    chosen = {v.time for v in scoring}
    assert len(scoring) == cameras * len(chosen) and 0.9 * MAX_VIEWS < len(scoring) <= MAX_VIEWS
    assert {0.0, 1.0} <= chosen  # from first to last
    assert scoring_views(scene) == list(scene.train)


def test_unsynchronised_cameras_are_scored_at_evenly_spread_moments():
    film = unsynchronised_film(frames=300)
    scoring = scoring_views(film)
    cameras = Counter(view.name.partition("_")[0] for view in scoring)
    assert 0.9 * MAX_VIEWS < len(scoring) <= MAX_VIEWS and len(cameras) == 4
    assert max(cameras.values()) - min(cameras.values()) <= 0.1 * MAX_VIEWS / 4


def test_least_sensitive_is_the_largest_set_within_the_share():
    weight = torch.from_numpy(np.random.default_rng(0).pareto(1.0, 300).astype(np.float32))
    weight[::7] = 0.0
    for share in (0.0, 1e-3, 0.05, 0.5, 0.999):
        few = least_sensitive(weight, share)
        inside, outside = weight[few].double(), weight[~few].double()
        total = weight.double().sum()
        assert inside.sum() <= share * total < inside.sum() + outside.min()  # one more would not fit
        assert len(inside) == 0 or inside.max() <= outside.min()
        assert few[weight == 0].all()
    assert least_sensitive(torch.ones(10), 0.35).tolist() == [True] * 3 + [False] * 7  # ties by index


def test_pruning_changes_images_less_than_removing_random_gaussians():
    scene, cfg = tiny_scene(views=3), tiny_config()
    whole, rng = random_model(scene, cfg, 60), np.random.default_rng(2)
    change, before, share = mean_sensitivity(whole, scene, cfg, draws=50), images_of(whole, scene, cfg), 0.02

    def changed(sensitivity: torch.Tensor, part: float) -> tuple[float, int]:
        model = whole.copy()
        removed = prune_by_sensitivity(Adam(model), sensitivity, part)
        return sum(float((a - b).square().sum()) for a, b in zip(images_of(model, scene, cfg), before)), removed

    least_change, removed = changed(change, share)
    assert 10 < removed < 50
    # Changes of n Gaussians add up to at most (Σ|Δ|)² <= n ΣΔ².
    assert least_change < removed * share * float(change.sum())
    random = [changed(torch.from_numpy(rng.permutation(60) >= removed).float(), 0.0) for _ in range(10)]
    assert all(number == removed and other > 3 * least_change for other, number in random)


def images_of(model, scene, cfg) -> list[torch.Tensor]:
    """Renders of the training views, (3, h, w) each."""
    requests = [Request(v.camera, v.time, scene.duration, near=cfg.scene.near) for v in scene.train]
    return [Rasterizer(threads=1).render(model.gaussians(), request).color.clone() for request in requests]


def test_pruning_updates_moments_keeps_the_sphere_and_never_removes_all():
    model = initialise(tiny_scene(), tiny_config(), np.random.default_rng(0))
    count = len(model)
    model = Model.restored(model.kind, model.state() | {"sphere": torch.arange(count) < 10})
    adam = Adam(model)
    adam.first["mean"][:, 0] = torch.arange(count)
    change = (torch.arange(count) % 2).float()
    change[:10] = 1e6  # of the sphere, which is not part of the total
    # All Gaussians of sensitivity 0; the share is less than the sensitivity of one of the others.
    assert prune_by_sensitivity(adam, change, 1e-3) == count // 2 - 5
    kept = [i for i in range(count) if i % 2 or i < 10]
    assert adam.first["mean"][:, 0].tolist() == kept
    assert prune_by_sensitivity(adam, torch.zeros(len(kept)), 0.5) == 0, "only the sphere would be left"
    model.sphere = None
    assert prune_by_sensitivity(adam, torch.zeros(len(kept)), 0.5) == 0 and len(model) == len(kept)


def test_sensitivity_0_is_pruned_only_if_all_views_are_scoring_views():
    model = initialise(tiny_scene(), tiny_config(), np.random.default_rng(0))
    count = len(model)
    change = torch.tensor([0.0, 1.0, 100.0, 100.0]).repeat(count // 4)
    assert prune_by_sensitivity(Adam(model.copy()), change, 0.01) == count // 2
    assert prune_by_sensitivity(Adam(model), change, 0.01, all_scored=False) == count // 4


def test_training_prunes_by_sensitivity(tmp_path):
    cfg = tiny_config(60)
    cfg.train.densify = dataclasses.replace(cfg.train.densify, prune_sensitivity=0.01, prune_sensitivity_every=20)
    model, unpruned = train_tiny(tmp_path / "run", cfg).model, train_tiny(tmp_path / "free", tiny_config(60)).model
    scene = tiny_scene()
    assert len(model) < 0.9 * len(unpruned)
    share, share_unpruned = (
        float(least_sensitive(mean_sensitivity(m, scene, cfg, draws=20), 0.01).float().mean())
        for m in (model, unpruned)
    )
    assert share < share_unpruned
    done = [row for row in TinyRun(tmp_path / "run").rows("log.jsonl") if row["event"] == "prune_sensitivity"]
    assert [row["iteration"] for row in done] == [20, 40] and sum(row["pruned"] for row in done) > 0
    assert done[-1]["n_gaussians"] >= len(model)


def pruning(cfg: TrainConfig) -> SensitivityPruning:
    return SensitivityPruning(tiny_scene(), dataclasses.replace(tiny_config(), train=cfg), ())


def test_when_pruning_is_due():
    rules = DensifyConfig(prune_sensitivity=0.01, prune_sensitivity_every=100, start=150, stop=300)
    cfg = TrainConfig(iterations=580, densify=rules)
    # Also after the last densification; not at 500, less than a period before the end.
    assert [i for i in range(581) if pruning(cfg).due(i, i)] == [200, 300, 400]
    # A time budget that ends at half of the iterations: the clock goes by two. 200 is at 400 of 620, and a hundred
    # iterations are left; of 580 there are 90.
    assert [i for i in range(291) if pruning(dataclasses.replace(cfg, iterations=620)).due(i, 2 * i)] == [200]
    assert not any(pruning(cfg).due(i, 2 * i) for i in range(291))
    off = TrainConfig(densify=DensifyConfig(prune_sensitivity_every=1))
    assert not any(pruning(off).due(i, i) for i in range(1000))  # by default
