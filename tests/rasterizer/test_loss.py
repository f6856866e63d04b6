"""The fused L1 + SSIM loss against float64 convolutions and autograd."""

from __future__ import annotations

import math

import pytest
import torch
import torch.nn.functional as F
from builders import generator
from torch import Tensor

from rasterizer.loss import l1_ssim


def plain_loss(image: Tensor, target: Tensor, weight: float) -> tuple[Tensor, Tensor, Tensor]:
    """(loss, L1, SSIM) of 3D Gaussian Splatting: window 11 × 11, σ = 1.5, zero padding, mean over pixels."""
    offset = torch.arange(11, dtype=torch.float64) - 5
    bell = torch.exp(-0.5 * (offset / 1.5) ** 2)
    window = (bell[:, None] * bell / bell.sum() ** 2).expand(3, 1, 11, 11)
    blur = lambda x: F.conv2d(x, window, padding=5, groups=3)  # noqa: E731
    mu_x, mu_y = blur(image), blur(target)
    var_x, var_y = blur(image * image) - mu_x**2, blur(target * target) - mu_y**2
    covariance = blur(image * target) - mu_x * mu_y
    c1, c2 = 0.01**2, 0.03**2
    ssim = ((2 * mu_x * mu_y + c1) * (2 * covariance + c2)) / ((mu_x**2 + mu_y**2 + c1) * (var_x + var_y + c2))
    l1, ssim = (image - target).abs().mean(), ssim.mean()
    return (1 - weight) * l1 + weight * (1 - ssim), l1, ssim


def pair(size: tuple[int, int], seed: int) -> tuple[Tensor, Tensor]:
    """(image, target): a smooth image and a noisy version of it, with uniform black and white areas as in renders."""
    rng = generator(seed)
    coarse = torch.rand(1, 3, 4, 5, generator=rng)
    target = F.interpolate(coarse, size, mode="bilinear")[0]
    target[:, : size[0] // 4] = 0
    target[:, :, : size[1] // 4] = 1
    image = target + 0.1 * torch.randn(3, *size, generator=rng)
    image[:, : size[0] // 8] = 0.01
    return image.contiguous(), target.contiguous()


@pytest.mark.parametrize("weight", [0.2, 0.0, 1.0])
@pytest.mark.parametrize("size", [(64, 48), (37, 53), (16, 16), (11, 11), (7, 5), (1, 1), (3, 40), (100, 1)])
def test_loss_and_gradient_match_the_formula(size: tuple[int, int], weight: float):
    image, target = pair(size, 1)
    loss, l1, ssim, d_image = l1_ssim(image, target, weight)
    leaf = image.double().requires_grad_()
    expected = plain_loss(leaf, target.double(), weight)
    (gradient,) = torch.autograd.grad(expected[0], leaf)
    # Variances are differences of blurs near 1, with an error of 1e-7 against c2 = 9e-4: 1e-4 in a uniform area, less
    # in the mean.
    for found, truth in zip((loss, l1, ssim), expected):
        assert found == pytest.approx(truth.item(), rel=2e-5, abs=1e-6)
    assert d_image.shape == image.shape
    assert (d_image - gradient).abs().max() <= 2e-4 * gradient.abs().max()


def test_equal_images_have_zero_loss_and_gradient():
    _, target = pair((33, 41), 2)
    loss, l1, ssim, d_image = l1_ssim(target, target.clone())
    assert l1 == 0 and ssim == pytest.approx(1, abs=1e-6) and abs(loss) < 1e-6
    # SSIM is at its maximum; only rounding remains, against 1 / (3 · 33 · 41) = 2.5e-4 for the gradient of L1
    assert d_image.abs().max() < 1e-6


def test_any_number_of_threads_gives_the_same_bits():
    image, target = pair((75, 61), 3)
    expected = l1_ssim(image, target, threads=1)
    for threads in (2, 3):
        found = l1_ssim(image, target, threads=threads)
        assert found[:3] == expected[:3] and torch.equal(found[3], expected[3])


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_non_finite_pixel_makes_the_loss_non_finite(value: float):
    image, target = pair((40, 40), 4)
    image[1, 20, 20] = value
    assert not math.isfinite(l1_ssim(image, target)[0])


def test_wrong_shapes_and_types_are_named():
    image, target = pair((20, 20), 5)
    with pytest.raises(ValueError, match="^target must be float32 .*got"):
        l1_ssim(image, target[:, :10].contiguous())
    with pytest.raises(ValueError, match="^image must be float32 .*got"):
        l1_ssim(image.double(), target)
