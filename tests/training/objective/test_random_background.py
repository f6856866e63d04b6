"""Random backgrounds, against composing the image over the colour with the scene reader."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from tiny import tiny_scene

from datasets.composition import compose, coverage
from pipeline.data.training_views import target_of
from pipeline.training.objective.random_background import over_random_background


def test_the_image_equals_composing_over_the_random_colour():
    rng = np.random.default_rng(5)
    rgba = rng.integers(0, 256, (32, 32, 4), dtype=np.uint8)
    scene = tiny_scene()
    view = replace(scene.train[2], image=compose(rgba, scene.background), coverage=coverage(rgba))
    target, background = over_random_background(target_of(view, 1.0), scene.background, rng)
    assert background != scene.background
    truth = torch.from_numpy(compose(rgba, background)).permute(2, 0, 1) / 255
    # Each of the two images was rounded to 8 bits once.
    torch.testing.assert_close(target.image, truth, rtol=0, atol=1.01 / 255)


def test_an_opaque_view_is_unchanged():
    scene = tiny_scene()
    whole = target_of(scene.train[2], 1.0)
    assert over_random_background(whole, scene.background, np.random.default_rng(0)) == (whole, scene.background)
