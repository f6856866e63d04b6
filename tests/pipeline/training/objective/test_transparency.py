"""The loss on opacity: its gradient against autograd, and closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from builders import random_gaussians
from tiny import tiny_scene

from pipeline.config.train_schema import RegularizationConfig, TrainConfig
from pipeline.data.training_views import target_of
from pipeline.model.model import Model
from pipeline.training.objective.terms import DrawnView
from pipeline.training.objective.transparency import Transparency, opacity_weight, relative_to_data
from pipeline.training.schedule import phase
from rasterizer import Gradients

SCENE = tiny_scene(views=51)  # one view at each of 51 times in one second


def model(motion: str = "full") -> Model:
    gaussians = random_gaussians(20, motion, torch.Generator().manual_seed(3))
    return Model.from_gaussians(
        type(gaussians)(
            **{"quat_right": None, **{name: tensor.float() for name, tensor in gaussians.tensors().items()}}
        )
    )


def test_the_gradient_is_that_of_the_weighted_mean_with_the_last_view_of_a_batch():
    found, term = model(), Transparency(0.7, SCENE)
    gradients = Gradients.zeros_like(found.gaussians())
    target, at = target_of(SCENE.train[0], 1.0), phase(1.0, TrainConfig(), SCENE.extent, 3, 2)
    term.add(gradients, found, DrawnView(target, at, batch=2, place=0))
    assert not any(tensor.any() for tensor in gradients.dense().values())
    term.add(gradients, found, DrawnView(target, at, batch=2, place=1))

    leaves = {key: tensor.double().requires_grad_() for key, tensor in found.parameters.items()}
    weight = (10 / (51 * leaves["log_scale"][:, 3].exp().detach())).clamp(max=1)
    (0.7 * (weight * leaves["opacity_logit"].sigmoid()).mean()).backward()
    for key, mine in gradients.dense().items():
        truth = leaves[key].grad if leaves[key].grad is not None else torch.zeros_like(leaves[key])
        # float32 against float64: a few rounding errors of 6e-8, relative to the largest of the field
        torch.testing.assert_close(mine.double(), truth, rtol=1e-5, atol=1e-6 * float(truth.abs().max()) + 1e-12)


def test_the_opacity_weight_falls_with_the_number_of_views_in_a_lifetime():
    """10 of 51 views: weight 1 for st = 0.1 s, ½ for 0.392 s, 10/51 for a static model."""
    found = model()
    found.parameters["log_scale"][:2, 3] = torch.tensor([0.1, 20 / 51]).log()
    weight = opacity_weight(found, SCENE)
    torch.testing.assert_close(weight[:2], torch.tensor([1.0, 0.5]))
    assert opacity_weight(model("static"), SCENE) == pytest.approx(10 / 51)
    assert opacity_weight(model("static"), tiny_scene(views=8)) == 1.0


def test_the_opacity_weight_is_1_for_dynamic_scenes_with_several_cameras():
    film = replace(SCENE, capture="multi_view")
    assert opacity_weight(model(), film) == 1.0


def test_the_weight_follows_the_covered_share_and_the_number_of_views():
    """tiny_scene's disc has a radius of 6 of 32 pixels; 51 views instead of 100."""
    rules = RegularizationConfig(opacity=2.0)
    red = np.stack([np.asarray(view.image)[..., 0] for view in SCENE.train])
    share = np.count_nonzero(red) / red.size
    assert share == pytest.approx(np.pi * 36 / 32**2, rel=0.05)  # the pixels whose centre is in the disc, not its area
    assert relative_to_data(rules, SCENE) == pytest.approx(2.0 * share)
    assert relative_to_data(replace(rules, reference_views=100.0), SCENE) == pytest.approx(2.0 * share * 100 / 51)
    assert relative_to_data(RegularizationConfig(), SCENE) == 0


def test_empty_background_does_not_shift_loss_against_regularization():
    """Images with a border of background, twice as wide and high: a quarter of the weight beside a quarter of the
    loss, which is a mean over all pixels."""
    framed = tuple(replace(view, image=np.pad(view.image, ((16, 16), (16, 16), (0, 0)))) for view in SCENE.train)
    rules = RegularizationConfig(opacity=1.0)
    assert relative_to_data(rules, replace(SCENE, train=framed)) == pytest.approx(relative_to_data(rules, SCENE) / 4)
