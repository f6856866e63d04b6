"""Densification: indicators against naive sums, selection, the distribution of children, pruning, opacity resets."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from pipeline.config.train_schema import DensifyConfig
from pipeline.model.model import Model, ModelKind
from pipeline.training.density.densification import (
    Densification,
    OpacityReset,
    choose_growth,
    densify,
    halved_opacity,
    reset_opacity,
    split_rows,
    to_prune,
)
from pipeline.training.density.statistics import Statistics
from pipeline.training.optimiser import Adam
from rasterizer import Camera, Rasterizer, Request, ViewGradient
from rasterizer.covariance import rotation_4d

EXTENT = 5.0  # clones up to a scale of 0.05, splits above
FULL = ModelKind("full", 0, 0)


def model_of(scales: list[float], opacity: float = 0.5, kind: ModelKind = FULL) -> Model:
    """Isotropic unrotated Gaussians of these spatial scales, time scale 0.2."""
    parameters = {name: torch.zeros(len(scales), *row) for name, row in kind.shapes().items()}
    parameters["log_scale"][:, :3] = torch.tensor(scales).log()[:, None]
    if kind.dims == 4:
        parameters["log_scale"][:, 3] = math.log(0.2)
    for name in ("quat_left", "quat_right"):
        if name in parameters:
            parameters[name][:, 0] = 1.0
    parameters["opacity_logit"].fill_(math.log(opacity / (1 - opacity)))
    return Model(kind, parameters)


def statistics_of(space: list[float], time: list[float]) -> Statistics:
    """Statistics of one iteration with these indicators."""
    statistics = Statistics(len(space))
    statistics.space += torch.tensor(space)
    statistics.time += torch.tensor(time)
    statistics.iterations += 1
    return statistics


def test_indicators_against_a_naive_sum() -> None:
    rng = torch.Generator().manual_seed(0)
    count, batch, width, height, duration = 9, 3, 40, 20, 2.5
    statistics = Statistics(count)
    space, time, seen = [0.0] * count, [0.0] * count, [0] * count
    for _ in range(6):
        views = [sorted(torch.randperm(count, generator=rng)[:4].tolist()) for _ in range(batch)]
        by_view = [
            (ids, torch.randn(4, 2, generator=rng), torch.randn(4, generator=rng), torch.rand(4, generator=rng) * 9)
            for ids in views
        ]
        statistics.begin()
        for ids, g2, gt, r in by_view:
            view = ViewGradient(torch.tensor(ids, dtype=torch.int32), g2, gt, r)
            statistics.add_view(view, Camera(width, height, 1, 1, 0, 0, np.eye(4)), duration)
        statistics.end(batch)
        for i in range(count):
            rows = [(g2[ids.index(i)], gt[ids.index(i)]) for ids, g2, gt, _ in by_view if i in ids]
            if rows:
                norms = [math.hypot(float(g[0]) * width / 2, float(g[1]) * height / 2) for g, _ in rows]
                space[i] += sum(norms) * batch / len(rows)
                time[i] += sum(abs(float(t)) * duration for _, t in rows) * batch / len(rows)
                seen[i] += 1
    found_space, found_time = statistics.indicators()
    expected = torch.tensor([[s / max(n, 1), t / max(n, 1)] for s, t, n in zip(space, time, seen)])
    # sums of at most 18 float32 terms
    assert torch.allclose(torch.stack([found_space, found_time], 1), expected, rtol=1e-5)


def test_small_gaussians_are_cloned_and_large_ones_split_by_either_indicator() -> None:
    model = model_of([0.01, 0.2, 0.01, 0.2, 0.01])
    statistics = statistics_of([3e-4, 3e-4, 0, 0, 1e-4], [0, 0, 2e-4, 2e-4, 5e-5])
    growth = choose_growth(model, statistics, DensifyConfig(), EXTENT, time_split=True)
    assert growth.clone.tolist() == [True, False, True, False, False]
    assert growth.split.tolist() == [False, True, False, True, False]
    for cfg, time_split in [(DensifyConfig(), False), (DensifyConfig(use_time_gradient=False), True)]:
        growth = choose_growth(model, statistics, cfg, EXTENT, time_split)
        assert (growth.clone | growth.split).tolist() == [True, True, False, False, False]


def test_at_the_cap_the_highest_priority_is_selected_first() -> None:
    model = model_of([0.01] * 6)
    statistics = statistics_of([3e-4, 9e-4, 3e-4, 0, 5e-4, 0], [0, 0, 0, 6e-4, 0, 0])
    growth = choose_growth(model, statistics, DensifyConfig(max_gaussians=9), EXTENT, True)
    assert growth.clone.tolist() == [False, True, False, True, True, False], "ratios 1.5 4.5 1.5 6 2.5 0"
    growth = choose_growth(model, statistics, DensifyConfig(max_gaussians=10), EXTENT, True)
    assert growth.clone.tolist() == [True, True, False, True, True, False], "ties by index"
    growth = choose_growth(model, statistics, DensifyConfig(max_gaussians=5), EXTENT, True)
    assert not growth.clone.any()


def rotated(count: int, kind: ModelKind = FULL) -> Model:
    """`count` copies of one strongly rotated, elongated Gaussian away from the origin."""
    parameters = {name: torch.zeros(count, *row) for name, row in kind.shapes().items()}
    parameters["mean"] += torch.tensor([1.0, -2.0, 3.0, 0.4][: kind.dims])
    parameters["log_scale"] += torch.tensor([0.3, 0.05, 0.1, 0.5][: kind.dims]).log()
    parameters["quat_left"] += torch.tensor([0.8, 0.3, -0.4, 0.2])
    if kind.motion == "full":
        parameters["quat_right"] += torch.tensor([0.5, -0.2, 0.7, 0.1])
    return Model(kind, parameters)


def covariance(model: Model) -> torch.Tensor:
    p = {name: tensor[:1].double() for name, tensor in model.parameters.items()}
    axes = (rotation_4d(p["quat_left"], p["quat_right"]) * p["log_scale"].exp()[:, None])[0]
    return axes @ axes.T


# 40,000 samples: the standard error of a variance is √(2/40000) = 0.7 %; the tolerance of 5 % is seven of them.
SAMPLES = 20_000


def test_split_samples_space_and_time_jointly() -> None:
    model = rotated(SAMPLES)
    mask = torch.ones(SAMPLES, dtype=torch.bool)
    rows = split_rows(model, mask, True, torch.Generator().manual_seed(0))
    assert len(rows["mean"]) == 2 * SAMPLES
    expected = covariance(model)
    assert (torch.cov(rows["mean"].T.double()) - expected).abs().max() < 0.05 * expected.max()
    assert (rows["mean"].mean(0) - model.parameters["mean"][0]).abs().max() < 0.02
    shrunk = model.parameters["log_scale"][0] - math.log(1.6)
    assert torch.allclose(rows["log_scale"], shrunk.expand(2 * SAMPLES, 4))
    for name in ("quat_left", "quat_right", "opacity_logit", "sh"):
        assert torch.equal(rows[name], model.parameters[name].repeat(2, *[1] * (rows[name].dim() - 1))), name


def test_split_in_space_only_keeps_time_and_samples_the_conditional() -> None:
    model = rotated(SAMPLES)
    mask = torch.ones(SAMPLES, dtype=torch.bool)
    rows = split_rows(model, mask, False, torch.Generator().manual_seed(0))
    assert torch.equal(rows["mean"][:, 3], torch.full((2 * SAMPLES,), 0.4))
    assert torch.equal(rows["log_scale"][:, 3], torch.full((2 * SAMPLES,), math.log(0.5)))
    assert torch.allclose(rows["log_scale"][:, :3], (model.parameters["log_scale"][0, :3] - math.log(1.6)))
    sigma = covariance(model)
    conditional = sigma[:3, :3] - torch.outer(sigma[:3, 3], sigma[3, :3]) / sigma[3, 3]  # the Schur complement
    found = torch.cov(rows["mean"][:, :3].T.double())
    assert (found - conditional).abs().max() < 0.05 * conditional.max()
    assert (conditional - sigma[:3, :3]).abs().max() > 0.1 * conditional.max(), "the marginal differs"


@pytest.mark.parametrize("kind", [ModelKind("separable", 0, 0), ModelKind("static", 0, 0)])
def test_split_of_models_without_4d_rotation(kind: ModelKind) -> None:
    model = rotated(10, kind)
    rows = split_rows(model, torch.ones(10, dtype=torch.bool), True, torch.Generator().manual_seed(0))
    assert rows["mean"].shape == (20, kind.dims) and (rows["mean"] != model.parameters["mean"].repeat(2, 1)).all()


def test_transparent_gaussians_are_always_pruned_and_large_ones_only_later() -> None:
    model = model_of([0.01, 0.6, 0.01])
    model.parameters["opacity_logit"][2] = -6.0  # 0.0025
    assert to_prune(model, 3000, DensifyConfig(), EXTENT).tolist() == [False, False, True]
    assert to_prune(model, 3001, DensifyConfig(), EXTENT).tolist() == [False, True, True]


def test_densify_clones_splits_prunes_and_updates_moments() -> None:
    model = model_of([0.01, 0.2, 0.02, 0.03])
    model.parameters["opacity_logit"][2] = -6.0
    model.parameters["mean"] += torch.arange(4)[:, None]
    optimiser = Adam(model)
    for tensors in (optimiser.first, optimiser.second):
        for tensor in tensors.values():
            tensor.fill_(1.0)
    done = densify(
        optimiser,
        statistics_of([3e-4, 3e-4, 3e-4, 0], [0] * 4),
        600,
        DensifyConfig(),
        EXTENT,
        True,
        torch.Generator().manual_seed(0),
    )
    assert (done.cloned, done.split, done.pruned, len(model)) == (1, 1, 1, 5)
    # parent 0, parent 3, the clone of 0, two children of 1
    assert torch.allclose(model.parameters["log_scale"][:, 0].exp(), torch.tensor([0.01, 0.03, 0.01, 0.125, 0.125]))
    assert torch.equal(model.parameters["mean"][:3, 0], torch.tensor([0.0, 3.0, 0.0]))
    assert optimiser.first["sh"].reshape(5, -1)[:, 0].tolist() == [1, 1, 0, 0, 0], "new Gaussians have zero moments"


@pytest.mark.parametrize("by_cause", [False, True])
def test_with_split_by_cause_a_split_by_space_keeps_the_temporal_scale(by_cause: bool) -> None:
    model = model_of([0.2, 0.2, 0.2])
    cfg = DensifyConfig(split_by_cause=by_cause, opacity_reset_every=0)
    statistics = statistics_of([1e-3, 0.0, 1e-3], [0.0, 1e-3, 1e-3])  # space, time, both
    densify(Adam(model), statistics, 600, cfg, EXTENT, True, torch.Generator().manual_seed(0))
    lifetimes = model.parameters["log_scale"][:, 3].exp().tolist()
    shrunk, kept = pytest.approx(0.2 / 1.6), pytest.approx(0.2)
    # With split_by_cause the children of splits by time come first.
    assert lifetimes == ([shrunk] * 4 + [kept] * 2 if by_cause else [shrunk] * 6)


def test_a_pruning_of_all_gaussians_is_skipped() -> None:
    optimiser = Adam(model_of([0.01, 0.02], opacity=0.001))
    done = densify(optimiser, Statistics(2), 600, DensifyConfig(), EXTENT, True, torch.Generator())
    assert len(optimiser.model) == 2 and done.pruned == 0


def test_opacity_reset_only_lowers_and_zeroes_moments() -> None:
    model = model_of([0.01, 0.01])
    model.parameters["opacity_logit"][1] = -5.5  # 0.0041, already lower
    optimiser = Adam(model)
    optimiser.first["opacity_logit"].fill_(1.0)
    reset_opacity(optimiser)
    opacity = torch.sigmoid(model.parameters["opacity_logit"])
    assert opacity.tolist() == pytest.approx([0.01, 1 / (1 + math.exp(5.5))], rel=1e-5)
    assert not optimiser.first["opacity_logit"].any()


def sphere_model(scales: list[float], sphere: list[bool], opacity: float = 0.5) -> Model:
    model = model_of(scales, opacity)
    model.sphere = torch.tensor(sphere)
    return model


def test_the_sphere_is_not_densified_and_not_counted_by_the_cap() -> None:
    sphere = [False, False, True, True, True, True]
    model = sphere_model([0.01, 0.2, 0.01, 0.2, 0.2, 0.2], sphere)
    growth = choose_growth(model, statistics_of([9e-4] * 6, [9e-4] * 6), DensifyConfig(), EXTENT, True)
    assert growth.clone.tolist() == [True] + [False] * 5 and growth.split.tolist() == [False, True] + [False] * 4
    growth = choose_growth(model, statistics_of([9e-4] * 6, [0] * 6), DensifyConfig(max_gaussians=3), EXTENT, True)
    assert growth.clone.any() != growth.split.any(), "two are not of the sphere, so one more fits under the cap"


def test_the_sphere_is_pruned_only_for_transparency_and_until_it_is_frozen() -> None:
    model = sphere_model([0.6, 0.6, 0.01, 0.01, 0.01], [True, False, True, False, True])
    model.parameters["opacity_logit"][2:4] = -6.0  # 0.0025
    late = to_prune(model, 3001, DensifyConfig(), EXTENT)
    assert late.tolist() == [False, True, True, True, False]
    frozen = to_prune(model, 3001, DensifyConfig(), EXTENT, train_sphere=False)
    assert frozen.tolist() == [False, True, False, True, False]


def test_densification_and_opacity_reset_do_not_change_a_frozen_sphere() -> None:
    model = sphere_model([0.01, 0.2, 0.6, 0.2, 0.6], [True, False, True, False, True], opacity=0.9)
    model.parameters["opacity_logit"][4] = -6.0  # 0.0025
    model.parameters["mean"] += torch.arange(5)[:, None]
    optimiser = Adam(model)
    for tensors in (optimiser.first, optimiser.second):
        for tensor in tensors.values():
            tensor.fill_(1.0)
    before = {name: tensor[model.sphere].clone() for name, tensor in model.parameters.items()}
    done = densify(
        optimiser,
        statistics_of([9e-4] * 5, [0] * 5),
        3100,
        DensifyConfig(),
        EXTENT,
        True,
        torch.Generator().manual_seed(0),
        train_sphere=False,
    )
    reset_opacity(optimiser, train_sphere=False)
    assert done.split == 2 and int(model.sphere.sum()) == 3 and len(model) == 7
    for name, tensor in model.parameters.items():
        assert torch.equal(tensor[model.sphere], before[name]), name
        assert (optimiser.first[name][model.sphere] == 1).all(), name
    assert (torch.sigmoid(model.parameters["opacity_logit"][~model.sphere]) < 0.0101).all()
    reset_opacity(optimiser)
    assert (torch.sigmoid(model.parameters["opacity_logit"]) < 0.0101).all(), "before it is frozen"


def test_when_densification_and_opacity_resets_are_due() -> None:
    cfg = DensifyConfig()
    densification = Densification(cfg, EXTENT, time_split=True)
    assert [i for i in range(1, 16_000) if densification.due(i, float(i))] == list(range(600, 15_000, 100))
    assert [i for i in range(1, 31_000) if OpacityReset(cfg).due(i, float(i))] == [3000, 6000, 9000, 12_000]
    assert not densification.due(600, 15_000.0), "the clock of a time budget ends densification"


def test_corrected_clones_let_as_much_light_through_as_one() -> None:
    opacity = torch.tensor([1e-6, 0.005, 0.1, 0.5, 0.9, 0.99, 1 - 1e-9], dtype=torch.float64)
    half = torch.sigmoid(halved_opacity(torch.logit(opacity)))
    torch.testing.assert_close((1 - half) ** 2, 1 - opacity, rtol=1e-6, atol=0)  # 1 - 1e-9 has 7 digits of 1 - α


def test_corrected_clones_hardly_change_the_image() -> None:
    """Every Gaussian is cloned. Without the correction the image becomes more opaque."""
    camera = Camera(32, 32, 40.0, 40.0, 16.0, 16.0, np.eye(4))
    change = {}
    for correct in (True, False):
        model = model_of([0.04] * 9)
        row, column = torch.meshgrid(torch.arange(3), torch.arange(3), indexing="ij")  # 7.5 σ apart
        model.parameters["mean"][:, 0], model.parameters["mean"][:, 1] = (
            0.3 * row.ravel() - 0.3,
            0.3 * column.ravel() - 0.3,
        )
        model.parameters["mean"][:, 2] = 2.0
        rules = DensifyConfig(correct_clones=correct)

        def image(model: Model = model) -> torch.Tensor:
            return Rasterizer(threads=1).render(model.gaussians(), Request(camera, 0.0)).color.clone()

        before = image()
        densify(Adam(model), statistics_of([1.0] * 9, [0.0] * 9), 10, rules, EXTENT, True, torch.Generator())
        assert len(model) == 18
        change[correct] = (image() - before).abs().max().item()
    # The pair is exact where alpha is h = 1 - √½ or 0, its Gaussians' peak and outside; in between, at a share G of the
    # peak, it has 1 - (1 - hG)² - ½G = (2h - ½) (G - G²), at most a quarter of 0.086. Colours are 0.5.
    assert change[True] < 0.5 * (2 * (1 - 0.5**0.5) - 0.5) / 4 + 1e-3 < 0.05 < change[False]
