"""The fused L1 + SSIM loss against float64 convolutions and autograd."""

from __future__ import annotations

import math
import subprocess
import sys

import pytest
import torch
import torch.nn.functional as F
from builders import generator
from torch import Tensor

from rasterizer.kernel_loader import kernel
from rasterizer.loss import SSIM_WEIGHT, PhotometricLoss
from rasterizer.reference.loss import photometric_terms


def photometric_loss(
    image: Tensor, target: Tensor, ssim_weight: float = SSIM_WEIGHT, mse_weight: float = 0.0, threads: int = 0
) -> tuple[float, float, float, Tensor]:
    """(loss, l1, ssim, ∂loss/∂image) of one pair."""
    value = PhotometricLoss(ssim_weight, mse_weight, threads)(image, target)
    return value.loss, value.l1, value.ssim, value.d_image


def plain_loss(image: Tensor, target: Tensor, weight: float, mse_weight: float = 0.0) -> tuple[Tensor, Tensor, Tensor]:
    """(loss, L1, SSIM) of the reference implementation."""
    l1, ssim, mse = photometric_terms(image, target)
    return (1 - weight) * l1 + weight * (1 - ssim) + mse_weight * mse, l1, ssim


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


@pytest.mark.parametrize("mse_weight", [0.0, 5.0])
@pytest.mark.parametrize("weight", [0.2, 0.0, 1.0])
@pytest.mark.parametrize("size", [(64, 48), (37, 53), (16, 16), (11, 11), (7, 5), (1, 1), (3, 40), (100, 1)])
def test_loss_and_gradient_match_the_formula(size: tuple[int, int], weight: float, mse_weight: float):
    image, target = pair(size, 1)
    loss, l1, ssim, d_image = photometric_loss(image, target, weight, mse_weight)
    leaf = image.double().requires_grad_()
    expected = plain_loss(leaf, target.double(), weight, mse_weight)
    (gradient,) = torch.autograd.grad(expected[0], leaf)
    # Variances are differences of blurs near 1, with an error of 1e-7 against c2 = 9e-4: 1e-4 in a uniform area, less
    # in the mean.
    for found, truth in zip((loss, l1, ssim), expected):
        assert found == pytest.approx(truth.item(), rel=2e-5, abs=1e-6)
    assert d_image.shape == image.shape
    assert (d_image - gradient).abs().max() <= 2e-4 * gradient.abs().max()


def test_equal_images_have_zero_loss_and_gradient():
    _, target = pair((33, 41), 2)
    loss, l1, ssim, d_image = photometric_loss(target, target.clone())
    assert l1 == 0 and ssim == pytest.approx(1, abs=1e-6) and abs(loss) < 1e-6
    # SSIM is at its maximum; only rounding remains, against 1 / (3 · 33 · 41) = 2.5e-4 for the gradient of L1
    assert d_image.abs().max() < 1e-6


def test_any_number_of_threads_gives_the_same_bits():
    image, target = pair((75, 61), 3)
    expected = photometric_loss(image, target, threads=1)
    for threads in (2, 3):
        found = photometric_loss(image, target, threads=threads)
        assert found[:3] == expected[:3] and torch.equal(found[3], expected[3])


def on_background(size: tuple[int, int], color: tuple[float, float, float], shape: str) -> tuple[Tensor, Tensor]:
    """(image, target): noise in the pixels of `shape`, shifted between the two, and `color` everywhere else."""
    height, width = size
    rng = generator(6)
    mask = torch.zeros(height, width, dtype=torch.bool)
    if shape == "object":  # within, so that blocks on all four sides of the image are background
        mask[height // 3 : height // 2, width // 3 : width // 2] = True
    elif shape == "border":
        mask[-2:], mask[:, -1] = True, True
    elif shape == "dots":  # single pixels, at the beginning, in the middle and at the end of blocks
        mask[height // 2, [width // 2, width // 2 + 21, -17]] = True
        mask[-1, 0] = True
    elif shape == "nearly everything":  # all that is background are the first pixels
        mask[:, 3:] = True
    empty = torch.tensor(color)[:, None, None].expand(3, height, width)
    noise = lambda: torch.rand(3, height, width, generator=rng)  # noqa: E731
    return torch.where(mask, noise(), empty), torch.where(mask.roll(1, 0) & mask, noise(), empty)


@pytest.mark.parametrize("color", [(0, 0, 0), (1, 1, 1), (0.3, 0, 0.7)], ids=["black", "white", "coloured"])
@pytest.mark.parametrize("shape", ["nothing", "object", "border", "dots", "nearly everything"])
@pytest.mark.parametrize("size", [(128, 160), (90, 119), (61, 64)])
def test_background_is_copied_to_the_same_bits(size: tuple[int, int], shape: str, color: tuple[float, float, float]):
    image, target = on_background(size, color, shape)

    def run(copy_background: bool, threads: int) -> tuple[tuple[float, float, float], Tensor]:
        gradient = torch.full_like(image, math.nan)
        value = kernel.photometric_loss(
            image, target, gradient, 0.2, 5.0, 1.0, threads, copy_background=copy_background
        )
        return value, gradient.view(torch.int32)  # bits: -0 is not 0

    expected, expected_gradient = run(copy_background=False, threads=1)
    for threads in (1, 2, 3):
        value, gradient = run(copy_background=True, threads=threads)
        assert value == expected and torch.equal(gradient, expected_gradient)

    leaf = image.double().requires_grad_()
    loss, l1, ssim = plain_loss(leaf, target.double(), 0.2, 5.0)
    (truth,) = torch.autograd.grad(loss, leaf)
    for found, true in zip(expected, (l1, ssim, ((leaf - target) ** 2).mean())):
        assert found == pytest.approx(true.item(), rel=2e-5, abs=1e-6)
    # as in test_loss_and_gradient_match_the_formula; of the gradient of L1 where the two images are equal
    scale = max(truth.abs().max().item(), 1 / truth.numel())
    assert (expected_gradient.view(torch.float32) - truth).abs().max() <= 2e-4 * scale


def test_what_is_not_background_is_never_skipped():
    """Image and target agree in the first pixel only, or one of them alone is empty, or a pixel is not a number."""
    image, target = pair((64, 48), 7)
    for a, b in ((image, target), (torch.zeros_like(image), target), (image, torch.zeros_like(image))):
        a, b = a.clone(), b.clone()
        a[:, 0, 0] = b[:, 0, 0] = 0
        leaf = a.double().requires_grad_()
        expected = plain_loss(leaf, b.double(), 0.2)
        (gradient,) = torch.autograd.grad(expected[0], leaf)
        loss, _, _, d_image = photometric_loss(a, b)
        assert loss == pytest.approx(expected[0].item(), rel=2e-5, abs=1e-6)
        assert (d_image - gradient).abs().max() <= 2e-4 * gradient.abs().max()
    empty = torch.zeros(3, 64, 64)
    broken = empty.clone()
    broken[2, 40, 40] = math.nan
    assert math.isnan(photometric_loss(broken, empty)[0]) and math.isnan(photometric_loss(empty, broken)[0])


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_non_finite_pixel_makes_the_loss_non_finite(value: float):
    image, target = pair((40, 40), 4)
    image[1, 20, 20] = value
    assert not math.isfinite(photometric_loss(image, target)[0])


def test_a_share_of_a_batch_scales_the_gradient_alone():
    image, target = pair((40, 30), 6)
    loss = PhotometricLoss(mse_weight=5.0, threads=1)
    whole, part = loss(image, target), loss(image, target, share=0.25)
    assert torch.equal(part.d_image, 0.25 * whole.d_image)  # a power of two: exact
    assert (part.loss, part.l1, part.ssim, part.mse) == (whole.loss, whole.l1, whole.ssim, whole.mse)
    # the sum in float64 of squares in float32, each off by 6e-8 of itself
    assert whole.mse == pytest.approx(((image.double() - target.double()) ** 2).mean().item(), rel=1e-6)


def test_wrong_shapes_and_types_are_named():
    image, target = pair((20, 20), 5)
    for wrong in (image.to("meta"), image.to_sparse()):
        with pytest.raises(ValueError, match="^image must be float32 .*got"):
            photometric_loss(wrong, target)
    with pytest.raises(ValueError, match="^target must be float32 .*got"):
        photometric_loss(image, target[:, :10].contiguous())
    with pytest.raises(ValueError, match="^image must be float32 .*got"):
        photometric_loss(image.double(), target)


def test_the_layout_of_the_image_does_not_matter() -> None:
    image, target = pair((20, 30), 4)
    expected = photometric_loss(image, target)
    strided = image.permute(1, 2, 0).contiguous().permute(2, 0, 1)  # as an image of (H, W, 3)
    loss, l1, ssim, gradient = photometric_loss(strided, target)
    assert (loss, l1, ssim) == expected[:3] and torch.equal(gradient, expected[3])


@pytest.mark.parametrize("shape", [(3, 0, 4), (3, 4, 0), (3, 5), (1, 3, 4, 4)])
def test_an_image_without_pixels_or_of_another_form_is_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match=r"image must be float32 \[3, H, W\] with at least one pixel, got"):
        photometric_loss(torch.zeros(shape), torch.zeros(shape))


OUT_OF_MEMORY = """
import resource, torch
from rasterizer.loss import PhotometricLoss
image = torch.zeros(3, 1, 2**20)
used = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (used + 2**27, used + 2**27))
try:
    PhotometricLoss(threads=2)(image, image)
except MemoryError:
    print("MemoryError")
"""


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc, and other systems do not enforce RLIMIT_AS")
def test_lack_of_memory_is_an_exception() -> None:
    """A row of 2²⁰ pixels takes 12 MB, a thread's scratch rows of it 474 MB, and 134 MB are allowed."""
    found = subprocess.run([sys.executable, "-c", OUT_OF_MEMORY], capture_output=True, text=True, timeout=120)
    assert (found.returncode, found.stdout.strip()) == (0, "MemoryError"), found.stderr
