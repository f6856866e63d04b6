"""`Gradients` and `ViewGradient`: finite checks, reset, densification statistics; with any number of threads."""

from __future__ import annotations

import math

import pytest
import torch
from builders import generator, off_centre_camera, random_gaussians

from rasterizer import Gradients, ViewGradient


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_single_non_finite_value_is_found_anywhere(value: float):
    """Enough rows for several threads, and a remainder that fills no vector."""
    gaussians = random_gaussians(40_009, "full", generator(15)).to(torch.float32)
    gradients = Gradients.zeros_like(gaussians)
    largest = torch.finfo(torch.float32).max
    for name, tensor in gradients.dense().items():
        flat = tensor.view(-1)
        for place in (0, len(flat) // 2, len(flat) - 1):
            for threads in (1, 3):
                flat[place] = -largest
                assert gradients.all_finite(threads), (name, place)
                flat[place] = value
                assert not gradients.all_finite(threads), (name, place)
                gradients.zero_(threads)
                assert not flat.any()


def test_views_accumulate_densification_statistics():
    """Against torch sums over three views that share Gaussians."""
    count, camera, duration, g = 1000, off_centre_camera(), 0.8, generator(16)
    views = []
    for _ in range(3):
        visible = torch.randperm(count, generator=g)[:700].sort().values.to(torch.int32)
        drawn = [torch.randn(700, *shape, generator=g) for shape in ((2,), (), ())]
        views.append(ViewGradient(visible, drawn[0], drawn[1], drawn[2].abs()))
    expected = [torch.zeros(count, dtype=torch.float64) for _ in range(3)]
    for view in views:
        index = view.visible.long()
        ndc = view.mean2d.double() * torch.tensor([0.5 * camera.width, 0.5 * camera.height])
        expected[0].index_add_(0, index, ndc.norm(dim=1))
        expected[1].index_add_(0, index, view.mean_t.double().abs() * duration)
        expected[2].index_add_(0, index, torch.ones(700, dtype=torch.float64))
    visible_once = expected[2] > 0
    for threads in (1, 3):
        found, marked = [torch.zeros(count) for _ in range(3)], torch.zeros(count, dtype=torch.uint8)
        for view in views:
            view.accumulate(*found, camera, duration, threads)
            view.mark_visible(marked, threads)
        for name, a, b in zip(("space", "time", "views"), found, expected, strict=True):
            # a few float32 roundings each
            torch.testing.assert_close(
                a.double(), b, rtol=1e-6, atol=1e-6, msg=lambda text, name=name: f"{name}: {text}"
            )
        assert torch.equal(marked.bool(), visible_once)
