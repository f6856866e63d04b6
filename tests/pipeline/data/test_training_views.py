"""Training images at reduced resolution, and their cache."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import torch
from tiny import tiny_scene

from pipeline.data.depth_targets import SparseDepth
from pipeline.data.optical_flow import MeasuredFlow
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


def test_flow_is_resized_once_where_it_fits_beside_the_images() -> None:
    views, width, height = tiny_scene().train, 32, 32
    pixels = len(views) * width * height
    asked: list[tuple[int, int]] = []

    def flow_of(index: int, camera: Camera) -> MeasuredFlow:
        asked.append((index, camera.width))
        return MeasuredFlow(0.1, torch.full((2, camera.height, camera.width), float(index)))

    flows = SimpleNamespace(at=flow_of)
    for limit, often in ((20 * pixels, 1), (20 * pixels - 1, 2)):  # 3 + 2 floats a pixel, and a byte less
        asked.clear()
        kept = TrainingViews(views, flows, cache_limit_bytes=limit)  # type: ignore[arg-type]
        first, second = kept.at(2, 1.0), kept.at(2, 1.0)
        assert asked == [(2, 32)] * often and first.image is second.image
        assert torch.equal(first.motion.flow, second.motion.flow) and (first.motion.flow == 2).all()
        assert kept.at(2, 0.5).motion.flow.shape == (2, 16, 16), "another scale is another flow"


def test_outside_a_mask_nothing_is_measured() -> None:
    """Flow is NaN there, depths are left out and no sky is known; inside, all stay."""
    view = tiny_scene().train[0]
    mask = np.zeros((32, 32), bool)
    mask[:, 16:] = True
    views = [replace(view, mask=mask, sky=np.ones((32, 32), bool))]
    pixel = torch.tensor([5, 20, 32 * 31 + 15, 32 * 31 + 16])  # columns 5, 20, 15, 16
    flows = SimpleNamespace(at=lambda index, camera: MeasuredFlow(0.1, torch.ones(2, 32, 32)))
    depths = SimpleNamespace(at=lambda index, camera, image: SparseDepth(pixel, torch.tensor([0.1, 0.2, 0.3, 0.4])))
    found = TrainingViews(views, flows, depths).at(0, 1.0)  # type: ignore[arg-type]
    assert found.depth.pixel.tolist() == [20, 32 * 31 + 16]
    torch.testing.assert_close(found.depth.inverse, torch.tensor([0.2, 0.4]))
    assert torch.equal(found.motion.flow.isfinite(), torch.from_numpy(mask).expand(2, 32, 32))
    assert torch.equal(found.sky[0] == 1, torch.from_numpy(mask)) and not found.sky[0, :, :16].any()
    none_inside = SimpleNamespace(at=lambda *_: SparseDepth(pixel[:1], torch.tensor([0.1])))
    assert TrainingViews(views, None, none_inside).at(0, 1.0).depth is None  # type: ignore[arg-type]
