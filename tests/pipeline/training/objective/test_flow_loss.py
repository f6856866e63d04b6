"""The flow loss: its gradient, through the kernel too."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from builders import random_gaussians, render
from tiny import tiny_config
from tiny_film import clip_past_a_plane, moving_plane

from datasets.scene import Scene
from pipeline.config.train_schema import RegularizationConfig
from pipeline.data.optical_flow import FlowTargets
from pipeline.data.training_views import TrainingViews
from pipeline.model.model import Model
from pipeline.training.objective.image_terms import FLOW_SOFTENING as SOFTENING
from pipeline.training.objective.image_terms import Photometric, flow_loss
from pipeline.training.objective.objective import Objective
from pipeline.training.objective.terms import DrawnView
from pipeline.training.schedule import phase
from rasterizer import Gaussians, Gradients, Request
from rasterizer.loss import PhotometricLoss
from rasterizer.reference import rasterize as reference


def random_flow(rng: torch.Generator) -> tuple[torch.Tensor, torch.Tensor]:
    """Rendered flow in pixels and measured flow in image widths, of errors around SOFTENING, a quarter not measured."""
    measured = 0.01 * torch.randn(2, 6, 8, generator=rng, dtype=torch.float64)
    rendered = 8 * (measured + 2 * SOFTENING * torch.randn(2, 6, 8, generator=rng, dtype=torch.float64))
    measured[:, torch.rand(6, 8, generator=rng) < 0.25] = torch.nan
    return rendered, measured


def test_the_gradient_equals_finite_differences() -> None:
    rendered, measured = random_flow(torch.Generator().manual_seed(0))
    _, gradient = flow_loss(rendered, measured, weight=3.0)
    step = 1e-6
    for index in np.ndindex(2, 6, 8):
        change = torch.zeros_like(rendered)
        change[index] = step
        difference = flow_loss(rendered + change, measured, 1.0)[0] - flow_loss(rendered - change, measured, 1.0)[0]
        # float64: 1e-16 of the loss over the step is 1e-12 of a gradient of 1e-3
        assert gradient[index].item() == pytest.approx(3 * difference / (2 * step), rel=1e-5, abs=1e-10)


def test_the_loss_is_the_mean_length_of_large_errors_and_0_without_error() -> None:
    measured = torch.zeros(2, 4, 10)
    assert flow_loss(10 * measured, measured, 1.0)[0] == 0
    rendered = torch.tensor([3.0, 4.0])[:, None, None].expand(2, 4, 10)  # 5 of 10 pixels: half the width
    assert flow_loss(rendered, measured, 1.0)[0] == pytest.approx(0.5, abs=SOFTENING)
    nowhere = torch.full((2, 4, 10), torch.nan)
    loss, gradient = flow_loss(rendered, nowhere, 1.0)
    assert loss == 0 and not gradient.any()


def test_flow_over_a_background_is_compared_with_the_share_of_the_gaussians() -> None:
    measured = 0.1 * torch.ones(2, 4, 10)
    alpha = torch.linspace(0, 1, 40).reshape(1, 4, 10)
    assert flow_loss(10 * alpha * measured, measured, 1.0, alpha)[0] == pytest.approx(0, abs=1e-9)
    assert flow_loss(10 * alpha * measured, measured, 1.0)[0] > 0.01


def l1_alone(self: Photometric, mse_weight: float, threads: int) -> None:
    self._criterion = PhotometricLoss(ssim_weight=0.0, threads=threads)


@pytest.mark.parametrize("make_scene", [moving_plane, clip_past_a_plane])
def test_the_gradient_of_a_batch_is_that_of_image_and_flow(
    make_scene: Callable[[], Scene], monkeypatch, tmp_path: Path
) -> None:
    """One view by the kernel, against autograd through the float64 reference implementation."""
    scene, weight = make_scene(), 50.0
    cfg = tiny_config()
    cfg = replace(cfg, train=replace(cfg.train, regularization=RegularizationConfig(flow=weight)))
    late = phase(60.0, cfg.train, scene.extent, 3, 2)
    gaussians = random_gaussians(40, "full", torch.Generator().manual_seed(2))  # float64 of float32 values
    model = Model.from_gaussians(gaussians.to(torch.float32))
    target = TrainingViews(scene.train, FlowTargets(scene, tmp_path)).at(1, 1.0)
    monkeypatch.setattr(Photometric, "__init__", l1_alone)
    gradients = Gradients.zeros_like(model.gaussians())
    objective = Objective(scene, cfg, 1)
    (found,) = objective.render(model, [DrawnView(target, late)])
    loss = objective.backward(model, found, gradients).loss

    leaves = {name: tensor.clone().requires_grad_() for name, tensor in gaussians.tensors().items()}
    request = Request(
        target.camera,
        target.time,
        scene.duration,
        scene.background,
        ("color", "flow", "alpha"),
        target.motion.step,
        cfg.scene.near,
        flow_camera=target.motion.camera,
    )
    out = render(reference, Gaussians.from_tensors(leaves), request)
    share = 1.0 if target.motion.camera is None else out.alpha.detach()
    error = torch.nan_to_num(out.flow / target.camera.width - share * target.motion.flow, nan=0.0)
    lengths = torch.sqrt(error.square().sum(dim=0) + SOFTENING**2) - SOFTENING
    expected = (out.color - target.image).abs().mean() + weight * lengths.mean()
    expected.backward()
    assert loss == pytest.approx(expected.item(), rel=1e-5)  # float32
    for name, found in gradients.dense().items():
        truth = leaves[name].grad
        # float32 against float64, and signs of L1 that differ where a pixel is almost right
        assert (found - truth).norm() < 2e-3 * truth.norm(), name
