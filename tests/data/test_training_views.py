"""Training images at reduced resolution, and their cache."""

from __future__ import annotations

import numpy as np
from tiny import tiny_scene

from pipeline.data.training_views import TrainingViews, area_average, target_of
from rasterizer import Camera


def test_coarser_views_are_averaged_over_areas() -> None:
    view = tiny_scene().train[0]
    half = target_of(view, 0.5)
    expected = view.image.reshape(16, 2, 16, 2, 3).mean(axis=(1, 3)).transpose(2, 0, 1) / 255
    np.testing.assert_allclose(half.image.numpy(), expected, atol=1e-6)  # float32 of values up to 1
    assert (half.camera.width, half.camera.fx, half.camera.cx) == (16, 20.0, 8.0)
    thirds = np.array([[2, 1, 0], [0, 1, 2]]) / 3  # shares of three old pixels in two new ones
    old = np.array([[0.0, 8.0, 4.0], [2.0, 5.0, 1.0], [9.0, 3.0, 7.0]])
    new = area_average(old, Camera(2, 2, 1.0, 1.0, 1.0, 1.0, np.eye(4)))
    np.testing.assert_allclose(new, thirds @ old @ thirds.T, atol=1e-6)
    whole = target_of(view, 1.0)
    np.testing.assert_array_equal(whole.image.numpy() * 255, view.image.transpose(2, 0, 1))


def test_views_are_cached_only_below_the_memory_limit() -> None:
    views = tiny_scene().train
    cached, uncached = TrainingViews(views), TrainingViews(views, cache_limit_bytes=1000)
    assert cached.at(2, 0.5) is cached.at(2, 0.5) and uncached.at(2, 0.5) is not uncached.at(2, 0.5)
    assert cached.at(2, 1.0).image.shape == (3, 32, 32), "another scale is another image"
