"""`rasterize` as an autograd function: what it refuses, and what it leaves out without a graph."""

from __future__ import annotations

import pytest
import torch
from builders import generator, off_centre_camera, random_gaussians

from rasterizer import Rasterizer, rasterize


def test_autograd_refuses_parameters_changed_in_place_and_second_derivatives():
    gaussians = random_gaussians(9, "full", generator(12)).to(torch.float32)
    mean = gaussians.mean.requires_grad_()
    loss = rasterize(gaussians, off_centre_camera()).color.square().sum()
    (gradient,) = torch.autograd.grad(loss, mean, create_graph=True)
    with pytest.raises(RuntimeError, match="once_differentiable"):
        gradient.sum().backward()
    loss = rasterize(gaussians, off_centre_camera()).color.square().sum()
    with torch.no_grad():
        mean += 0.1
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        loss.backward()


@pytest.mark.parametrize("mode", [torch.no_grad, torch.inference_mode])
def test_rendering_without_a_graph(mode, monkeypatch):
    """The same image, and nothing computed for a backward pass."""
    gaussians = random_gaussians(9, "full", generator(12)).to(torch.float32)
    gaussians.mean.requires_grad_()
    expected = rasterize(gaussians, off_centre_camera()).color.detach()
    asked, original = [], Rasterizer.render

    def render(self, *arguments, differentiable):
        asked.append(differentiable)
        return original(self, *arguments, differentiable=differentiable)

    monkeypatch.setattr(Rasterizer, "render", render)
    with mode():
        found = rasterize(gaussians, off_centre_camera()).color
    assert asked == [False]
    torch.testing.assert_close(found.clone(), expected, rtol=0, atol=5e-7)  # separate template instances
