"""Depth and sky losses: values against their formulas, gradients against autograd and, through the kernel, against the
reference implementation in float64."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from builders import camera_looking_at, generator, random_gaussians

from pipeline.data.depth_targets import SparseDepth, sparse
from pipeline.training.objective.image_terms import inverse_depth, sky_loss, sparse_depth_loss
from rasterizer import Gradients, Rasterizer, Request
from rasterizer.reference import rasterize as reference

HEIGHT, WIDTH = 6, 8
WEIGHT = 0.7


def random_images(seed: int) -> tuple[torch.Tensor, torch.Tensor]:
    """(depth, alpha), (1, H, W) float64: alpha in [0, 0.99], depths of 1 to 5 times alpha; a pixel shows nothing."""
    generator = torch.Generator().manual_seed(seed)
    alpha = 0.99 * torch.rand(1, HEIGHT, WIDTH, generator=generator, dtype=torch.float64)
    depth = alpha * (1 + 4 * torch.rand(1, HEIGHT, WIDTH, generator=generator, dtype=torch.float64))
    alpha[0, 0, 0] = depth[0, 0, 0] = 0.0
    return depth, alpha


def targets(seed: int) -> SparseDepth:
    depth = np.zeros((HEIGHT, WIDTH), np.float32)
    rng = np.random.default_rng(seed)
    depth.reshape(-1)[rng.permutation(HEIGHT * WIDTH)[:20]] = rng.uniform(1, 6, 20)
    depth[0, 0] = 2.0
    return sparse(depth)


def written_out(depth: torch.Tensor, alpha: torch.Tensor, target: SparseDepth) -> torch.Tensor:
    """The docstring's formula; the pixel without a Gaussian has inverse depth 0."""
    at = target.pixel
    shown = depth.reshape(-1)[at] > 0
    rho = torch.where(shown, alpha.reshape(-1)[at] ** 2 / torch.where(shown, depth.reshape(-1)[at], 1.0), 0.0)
    return WEIGHT * (rho - target.inverse.double()).abs().mean()


def test_sparse_depth_loss_and_gradient() -> None:
    depth, alpha = random_images(0)
    target = targets(1)
    found = sparse_depth_loss(depth, alpha, target, WEIGHT)
    leaves = [depth.clone().requires_grad_(), alpha.clone().requires_grad_()]
    expected = written_out(*leaves, target)
    assert found.loss == pytest.approx(expected.item(), rel=1e-6)
    d_depth, d_alpha = torch.autograd.grad(expected, leaves)
    torch.testing.assert_close(found.depth, d_depth, rtol=1e-6, atol=1e-12)
    torch.testing.assert_close(found.alpha, d_alpha, rtol=1e-6, atol=1e-12)


def test_sky_loss_and_gradient() -> None:
    depth, alpha = random_images(2)
    sky = torch.rand(1, HEIGHT, WIDTH, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
    found = sky_loss(depth, alpha, sky, 0.3)
    leaves = [depth.clone().requires_grad_(), alpha.clone().requires_grad_()]
    shown = leaves[0] > 0
    rho = torch.where(shown, leaves[1] ** 2 / torch.where(shown, leaves[0], 1.0), 0.0)
    expected = (sky * 0.3 * rho).sum() / sky.sum()
    assert found.loss == pytest.approx(expected.item(), rel=1e-9)
    for one, other in zip((found.depth, found.alpha), torch.autograd.grad(expected, leaves)):
        torch.testing.assert_close(one, other, rtol=1e-9, atol=1e-12)


def test_full_and_empty_pixels_are_finite() -> None:
    """A pixel without Gaussians has inverse depth 0 and no gradient."""
    depth, alpha = torch.tensor([[[0.0, 3.0, 1e-9]]]), torch.tensor([[[0.0, 1.0, 1e-9]]])
    for found in (
        sky_loss(depth, alpha, torch.ones(1, 1, 3), 1.0),
        sparse_depth_loss(depth, alpha, SparseDepth(torch.arange(3), torch.full((3,), 0.5)), 1.0),
    ):
        assert np.isfinite(found.loss)
        assert torch.isfinite(found.depth).all() and torch.isfinite(found.alpha).all()
    rho, by_depth, by_alpha = inverse_depth(depth, alpha)
    assert rho[0, 0, 0] == by_depth[0, 0, 0] == by_alpha[0, 0, 0] == 0


def test_gradient_through_the_kernel_is_that_of_the_reference() -> None:
    """∂(LiDAR loss + sky loss)/∂parameters, kernel in float32 against autograd through the reference in float64.

    Tolerance: 1e-3 of the largest entry; float32 blending of 30 Gaussians, divided by depths of pixels of low alpha.
    """
    camera = camera_looking_at((0.0, 0.0, -4.0), 16, 12, 14.0)
    exact = random_gaussians(30, "full", generator(4))
    gaussians = exact.to(torch.float32)
    depth = np.zeros((12, 16), np.float32)
    depth[::2, ::3] = 3.7
    target, sky = sparse(depth), torch.zeros(1, 12, 16)
    sky[:, :4] = 1.0

    rasterizer, request = Rasterizer(threads=1), Request(camera, 0.4, outputs=("alpha", "depth"))
    out = rasterizer.render(gaussians, request)
    of_loss = sparse_depth_loss(out.depth, out.alpha, target, 1.0) + sky_loss(out.depth, out.alpha, sky, 0.3)
    found = Gradients.zeros_like(gaussians)
    rasterizer.backward(found, d_alpha=of_loss.alpha, d_depth=of_loss.depth)

    precise = {name: tensor.clone().requires_grad_() for name, tensor in exact.tensors().items()}
    image = reference(type(gaussians)(**precise), camera, time=0.4, outputs=("alpha", "depth"))
    shown = image.depth > 1e-6
    rho = torch.where(shown, image.alpha**2 / torch.where(shown, image.depth, 1.0), 0.0)
    loss = (rho.reshape(-1)[target.pixel] - target.inverse.double()).abs().mean()
    loss = loss + (sky * 0.3 * rho).sum() / sky.sum()
    names = [name for name in precise if name != "sh"]
    for name, expected in zip(names, torch.autograd.grad(loss, [precise[name] for name in names])):
        error = (found.dense()[name].double() - expected).abs().max() / expected.abs().max()
        assert error < 1e-3, f"{name}: {error:.2e}"
