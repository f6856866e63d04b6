"""The covered share against counts known from how the images are made."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tiny import tiny_scene

from datasets.composition import BORDER_TOLERANCE
from pipeline.data.covered_share import covered_share

VIEW = tiny_scene().train[0]
GREY = (0.5, 0.5, 0.5)  # 127.5 of 255


def of(*images: np.ndarray, background=GREY) -> float:
    return covered_share([replace(VIEW, image=image) for image in images], background)


def plain(level: int = 128) -> np.ndarray:
    return np.full((10, 20, 3), level, np.uint8)


def test_a_pixel_counts_if_one_channel_differs():
    image = plain()
    image[2:7, 3:13, 1] = 200  # 50 of 200 pixels
    assert of(image) == 0.25
    assert of(image, plain(), background=GREY) == 0.125  # the mean over the views


def test_pixels_that_a_mask_leaves_out_do_not_count():
    mask = np.ones((10, 20), bool)
    mask[:, :5] = False  # a quarter
    assert covered_share([replace(VIEW, image=plain(0), mask=mask)], GREY) == 0.75


def test_compression_artefacts_of_the_background_do_not_count():
    noise = np.random.default_rng(0).integers(-BORDER_TOLERANCE + 1, BORDER_TOLERANCE, (10, 20, 3))
    image = (plain().astype(int) + noise).astype(np.uint8)
    image[0] = 255  # 20 of 200 pixels
    assert of(image) == 0.1


def test_images_that_fill_the_frame_and_empty_ones_have_the_weight_1():
    assert of(plain(3)) == 1.0
    assert of(plain()) == 1.0


def test_few_of_many_views_are_read():
    """300 views, alternating half and fully covered: those that are read are spread over them."""
    half = plain()
    half[:5] = 0
    assert of(*[half, plain(0)] * 150) == pytest.approx(0.75, abs=0.05)
