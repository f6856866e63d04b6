"""Pruning by visibility: the measure against sums over pixels, closed forms, and the pruning."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from tiny import TinyRun, tiny_config, tiny_scene, train_tiny

from pipeline.model.initialise import initialise
from pipeline.model.model import Model
from pipeline.training.density.visibility_pruning import (
    MIN_UNOCCLUDED,
    SCALE,
    VisibilityPruning,
    prune_hidden,
    visibility,
)
from pipeline.training.optimiser import Adam
from rasterizer import Request
from rasterizer.reference.blend import blending_weights, pixel_centers, splat_alpha
from rasterizer.reference.render import make_splats

FULL = 1 / SCALE  # the resolution at which visibility is measured in images of full size


def model_of(rows: list[tuple[tuple[float, float, float], float, float]]) -> Model:
    """Isotropic Gaussians at rest that live long: (position, σ, opacity) each."""
    model = initialise(tiny_scene(), tiny_config(), np.random.default_rng(0))
    model = Model.restored(model.kind, {name: tensor[: len(rows)] for name, tensor in model.state().items()})
    for i, (position, sigma, opacity) in enumerate(rows):
        model.parameters["mean"][i] = torch.tensor([*position, 0.0])
        model.parameters["log_scale"][i] = torch.tensor([sigma] * 3 + [100.0]).log()
        model.parameters["opacity_logit"][i] = torch.logit(torch.tensor(opacity))
    return model


def test_visibility_is_the_share_of_a_gaussian_that_reaches_a_camera():
    """Against sums over the pixels in float64, without the closed form, of the most favourable of three views."""
    scene, cfg = tiny_scene(views=3), tiny_config()
    rng = np.random.default_rng(3)
    rows = [(tuple(rng.uniform(-0.5, 0.5, 3)), rng.uniform(0.15, 0.3), rng.uniform(0.3, 0.98)) for _ in range(40)]
    model = model_of(rows)
    found = visibility(model, scene.train, scene, cfg, FULL, threads=1)
    expected = torch.zeros(40, dtype=torch.float64)
    for view in scene.train:
        splats = make_splats(model.gaussians().to(torch.float64), Request(view.camera, view.time, scene.duration))
        alpha = splat_alpha(splats, pixel_centers(view.camera, torch.float64).reshape(-1, 2))
        weight, _ = blending_weights(alpha)
        expected[splats.index] = torch.maximum(expected[splats.index], weight.sum(dim=1) / alpha.sum(dim=1))
    assert expected.min() < 0.1 < 0.9 < expected.max()
    # σ >= 1.5 px: a sum over pixels cut off at α = 1/255 differs by at most 2 % from its integral, and up to 1 % of an
    # ellipse is outside the image.
    torch.testing.assert_close(found.double(), expected, rtol=0.03, atol=1e-3)


def test_what_a_wall_hides_is_visible_from_the_side_only():
    scene, cfg = tiny_scene(views=4), tiny_config()
    camera = scene.train[0].camera
    toward = torch.from_numpy(np.asarray(camera.position)).float()
    toward = 0.6 * toward / toward.norm()
    wall = [(tuple((toward + torch.tensor([0.1 * x, 0.1 * y, 0.0])).tolist()), 0.1, 0.98)
            for x in range(-3, 4) for y in range(-3, 4)]  # fmt: skip
    model = model_of([((0.0, 0.0, 0.0), 0.05, 0.5), *wall])
    front = [dataclasses.replace(scene.train[0], camera=camera)]
    behind = np.asarray(camera.world_to_cam) @ np.diag([-1.0, 1.0, -1.0, 1.0])  # from the other side of the origin
    back = [dataclasses.replace(scene.train[0], camera=dataclasses.replace(camera, world_to_cam=behind))]
    assert float(visibility(model, front, scene, cfg, FULL, 1)[0]) < 1e-3
    # alone in its pixels: 3 % by the sum over pixels of a Gaussian of σ = 0.7 px
    assert float(visibility(model, front + back, scene, cfg, FULL, 1)[0]) == pytest.approx(1, abs=0.03)


def test_a_gaussian_in_no_image_is_kept():
    scene, cfg = tiny_scene(views=2), tiny_config()
    model = model_of([((0.0, 0.0, 0.0), 0.1, 0.5), ((0.0, 50.0, 0.0), 0.1, 0.5), ((0.0, 0.3, 0.0), 0.001, 0.005)])
    found = visibility(model, scene.train, scene, cfg, FULL, 1)
    # The second is outside of all images. Σ α' of the third, as wide as the dilation, is below MIN_UNOCCLUDED.
    assert 2 * np.pi * 0.3 * 0.005 < MIN_UNOCCLUDED
    assert found[1:].tolist() == [1.0, 1.0] and found[0] > 0.9


def test_pruning_updates_moments_keeps_the_sphere_and_never_removes_all():
    model = initialise(tiny_scene(), tiny_config(), np.random.default_rng(0))
    count = len(model)
    model = Model.restored(model.kind, model.state() | {"sphere": torch.arange(count) < 10})
    adam = Adam(model)
    adam.first["mean"][:, 0] = torch.arange(count)
    visible = 0.2 * (torch.arange(count) % 2)
    assert prune_hidden(adam, visible, 0.1) == count // 2 - 5
    kept = [i for i in range(count) if i % 2 or i < 10]
    assert adam.first["mean"][:, 0].tolist() == kept
    assert prune_hidden(adam, torch.zeros(len(kept)), 0.1) == 0, "only the sphere would be left"
    model.sphere = None
    assert prune_hidden(adam, torch.zeros(len(kept)), 0.1) == 0 and len(model) == len(kept)


def test_training_prunes_what_is_hidden(tmp_path):
    cfg = tiny_config(60)
    off = VisibilityPruning(tiny_scene(), cfg, ())
    assert not any(off.due(iteration, iteration) for iteration in range(61)), "off unless it is set"
    cfg.train.densify = dataclasses.replace(cfg.train.densify, prune_hidden=0.9, prune_sensitivity_every=20)
    train_tiny(tmp_path, cfg)
    events = [row for row in TinyRun(tmp_path).rows("log.jsonl") if row["event"] == "prune_hidden"]
    assert [row["iteration"] for row in events] == [20, 40], "not in the last period"
    assert sum(row["pruned"] for row in events) > 0
