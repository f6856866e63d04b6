"""What a view is trained on in place of what it is: each part against its definition."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from tiny import tiny_config, tiny_scene

from datasets.dnerf import compose, coverage
from pipeline.initialise import initialise
from pipeline.perturb import perturb
from pipeline.views import target_of
from rasterizer import rasterize


def draw(scene, cfg, seed=0, view=2):
    model = initialise(scene, cfg, np.random.default_rng(0))
    return model, perturb(model, target_of(scene.train[view], 1.0), scene, cfg.train, np.random.default_rng(seed))


def test_dropped_gaussians_are_as_if_they_were_not_there():
    scene, cfg = tiny_scene(), tiny_config(dropout=0.4)
    model, drawn = draw(scene, cfg)
    kept = drawn.gaussians.opacity_logit == model.parameters["opacity_logit"]
    # 200 Gaussians, each out with probability 0.4: five standard deviations of the binomial.
    assert abs(int((~kept).sum()) - 80) < 5 * (200 * 0.24) ** 0.5
    fewer = type(drawn.gaussians)(**{"quat_right": None, **{
        name: tensor[kept] for name, tensor in model.gaussians().tensors().items()}})
    arguments = dict(camera=drawn.target.camera, time=drawn.target.time)
    assert torch.equal(rasterize(drawn.gaussians, **arguments).color, rasterize(fewer, **arguments).color)


def test_time_moves_by_at_most_the_jitter():
    scene, cfg = tiny_scene(views=8), tiny_config(time_jitter=0.5)
    assert scene.frame_spacing == pytest.approx(1 / 7)
    shifts = [draw(scene, cfg, seed)[1].target.time - scene.train[2].time for seed in range(200)]
    assert max(map(abs, shifts)) <= 0.5 / 7
    assert max(shifts) > 0.4 / 7 and min(shifts) < -0.4 / 7  # uniform: 200 draws miss a tenth with chance 1e-5


def test_another_background_is_what_the_reader_would_have_composed():
    generator = np.random.default_rng(5)
    rgba = generator.integers(0, 256, (32, 32, 4), dtype=np.uint8)
    scene = tiny_scene()
    views = list(scene.train)
    views[2] = replace(views[2], image=compose(rgba, scene.background), coverage=coverage(rgba))
    scene = replace(scene, train=tuple(views))
    _, drawn = draw(scene, tiny_config(random_background=True))
    assert drawn.background != scene.background
    truth = torch.from_numpy(compose(rgba, drawn.background)).permute(2, 0, 1) / 255
    # Each of the two images was rounded to 8 bits once.
    torch.testing.assert_close(drawn.target.image, truth, rtol=0, atol=1.01 / 255)


def test_a_view_without_background_keeps_its_own():
    scene = tiny_scene()
    _, drawn = draw(scene, tiny_config(random_background=True))
    assert drawn.background == scene.background
    assert torch.equal(drawn.target.image, target_of(scene.train[2], 1.0).image)


def test_so_many_views_show_one_colour():
    scene, cfg = tiny_scene(), tiny_config(color_dropout=0.25)
    drawn = [draw(scene, cfg, seed)[1].one_color for seed in range(200)]
    # Five standard deviations of the binomial.
    assert abs(sum(drawn) - 50) < 5 * (200 * 0.25 * 0.75) ** 0.5
