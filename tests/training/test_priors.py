"""The priors against what they say they are: finite differences, closed forms, and the rotation they penalise."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from builders import random_gaussians
from tiny import tiny_scene

from pipeline.config.train_schema import RegularizationConfig
from pipeline.model.model import Model
from pipeline.training.objective.regularization import (
    DECAY_EVERY,
    TILT_SOFTENING,
    add_regularization_gradients,
    decay_colors,
    lack_of_views,
    tilt,
)
from rasterizer import Gradients
from rasterizer.covariance import rotation_4d

SCENE = tiny_scene(views=51)  # one camera, 51 moments of one second
SPACING = 0.02


def model(motion: str = "full") -> Model:
    gaussians = random_gaussians(20, motion, torch.Generator().manual_seed(3))
    return Model.from_gaussians(
        type(gaussians)(
            **{"quat_right": None, **{name: tensor.float() for name, tensor in gaussians.tensors().items()}}
        )
    )


def penalty(p: dict[str, torch.Tensor], cfg: RegularizationConfig) -> torch.Tensor:
    """The sum of the priors as the configuration words them, written out; any dtype."""
    turned = torch.sqrt(tilt(p["quat_left"], p["quat_right"]) ** 2 + TILT_SOFTENING**2)
    lifetime = p["log_scale"][:, 3].exp()
    weight = (cfg.opacity_views / (51 * lifetime.detach())).clamp(max=1) if cfg.opacity_views else 1.0
    return (
        cfg.motion * turned.mean()
        + cfg.lifetime * (SPACING / lifetime).mean()
        + cfg.opacity * (weight * p["opacity_logit"].sigmoid()).mean()
    )


@pytest.mark.parametrize(
    "keys", [{"motion": 0.7}, {"lifetime": 0.7}, {"opacity": 0.7}, {"opacity": 0.7, "opacity_views": 20.0}]
)
def test_the_gradient_is_that_of_the_penalty(keys):
    found, cfg = model(), RegularizationConfig(**keys)
    gradients = Gradients.zeros_like(found.gaussians())
    add_regularization_gradients(gradients, found, cfg, SCENE)
    leaves = {key: tensor.double().requires_grad_() for key, tensor in found.parameters.items()}
    penalty(leaves, cfg).backward()
    for key, mine in gradients.dense().items():
        truth = leaves[key].grad if leaves[key].grad is not None else torch.zeros_like(leaves[key])
        # float32 against float64: a few roundings of 6e-8 each, relative to the field's largest
        torch.testing.assert_close(mine.double(), truth, rtol=1e-5, atol=1e-6 * float(truth.abs().max()) + 1e-12)


def test_opacity_is_let_be_where_many_views_share_a_lifetime():
    """20 of 51 views: all of the pull on what lives for 0.1 s, half of it on 0.784, 20/51 where nothing moves."""
    found, cfg = model(), RegularizationConfig(opacity=1.0, opacity_views=20.0)
    found.parameters["log_scale"][:2, 3] = torch.tensor([0.1, 40 / 51]).log()
    weight = lack_of_views(found, cfg, SCENE)
    torch.testing.assert_close(weight[:2], torch.tensor([1.0, 0.5]))
    assert lack_of_views(model("static"), cfg, SCENE) == pytest.approx(20 / 51)
    assert lack_of_views(model("static"), RegularizationConfig(opacity=1.0, opacity_views=60.0), SCENE) == 1.0


def test_opacity_is_pulled_at_alike_where_several_cameras_film_what_moves():
    twice, cfg = replace(SCENE, train=SCENE.train + SCENE.train), RegularizationConfig(opacity=1.0, opacity_views=20.0)
    assert twice.train_times == SCENE.train_times and len(twice.train) == 2 * len(twice.train_times)
    assert lack_of_views(model(), cfg, twice) == 1.0


def test_tilt_is_twice_the_sine_of_half_the_angle_of_the_time_axis():
    generator = torch.Generator().manual_seed(0)
    left, right = (torch.randn(50, 4, generator=generator, dtype=torch.float64) for _ in range(2))
    along = rotation_4d(left, right)[:, 3, 3]  # how much of the time axis stays in time: cos θ
    # Closed form, float64: 1e-12 is rounding.
    torch.testing.assert_close(tilt(left, right) ** 2, 2 - 2 * along, rtol=1e-12, atol=1e-12)


def test_a_rotation_of_space_alone_has_no_tilt():
    left = torch.randn(50, 4, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    right = left * torch.tensor([1.0, 1.0, 1.0, -1.0])
    rotation = rotation_4d(left, right)
    torch.testing.assert_close(rotation[:, 3], torch.tensor([0.0, 0, 0, 1]).double().expand(50, 4), atol=1e-14, rtol=0)
    assert tilt(left, right).max() < 1e-14


def test_no_prior_changes_nothing():
    found = model()
    gradients = Gradients.zeros_like(found.gaussians())
    add_regularization_gradients(gradients, found, RegularizationConfig(), SCENE)
    assert all(not tensor.any() for tensor in gradients.dense().values())


@pytest.mark.parametrize("motion", ["static", "separable"])
def test_models_without_the_part_get_no_such_pull(motion):
    found = model(motion)
    gradients = Gradients.zeros_like(found.gaussians())
    add_regularization_gradients(gradients, found, RegularizationConfig(motion=1.0, lifetime=1.0), SCENE)
    assert not gradients.quat_left.any()
    assert gradients.log_scale[:, 3:].any() == (motion == "separable")


def test_colours_decay_but_the_constant_one():
    found = model()
    before = found.parameters["sh"].clone()
    decay_colors(found, strength=4.0, rate=1e-3)
    assert torch.equal(found.parameters["sh"][:, 0], before[:, 0])
    # One float32 rounding a coefficient.
    torch.testing.assert_close(
        found.parameters["sh"][:, 1:], before[:, 1:] * math.pow(1 - 4e-3, DECAY_EVERY), rtol=1e-6, atol=0
    )
