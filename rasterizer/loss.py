"""The photometric loss of 3D Gaussian Splatting, L1 + D-SSIM, optionally with MSE, and its gradient, fused in C++."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from rasterizer import on_device
from rasterizer.cores import thread_count
from rasterizer.kernel_loader import kernel
from rasterizer.validation import check_array, plain

SSIM_WEIGHT = 0.2  # λ, of 3DGS and the paper


@dataclass(frozen=True)
class LossValue:
    """(1-λ) L1 + λ (1-SSIM) + μ MSE of an image against its target."""

    loss: float
    l1: float
    ssim: float
    mse: float
    d_image: Tensor  # (3, H, W) share × ∂loss/∂image


class PhotometricLoss:
    """The loss as a callable, with fixed λ (`ssim_weight`), μ (`mse_weight`) and number of threads (0: all cores)."""

    def __init__(self, ssim_weight: float = SSIM_WEIGHT, mse_weight: float = 0.0, threads: int = 0) -> None:
        self.ssim_weight, self.mse_weight = ssim_weight, mse_weight
        self.threads = thread_count(threads)

    def __call__(self, image: Tensor, target: Tensor, share: float = 1.0) -> LossValue:
        """image, target: (3, H, W) float32 in [0, 1]; ValueError for other shapes or types.

        share: weight of this pair in the mean over a batch; scales the gradient only.
        """
        if image.ndim != 3 or image.numel() == 0:
            raise ValueError(f"image must be float32 [3, H, W] with at least one pixel, got {list(image.shape)}")
        if on_device.is_on_device(image) and image.device == target.device:
            l1, ssim, mse, d_image = on_device.photometric_loss(image, target, self.ssim_weight, self.mse_weight, share)
            return LossValue(self._of(l1, ssim, mse), l1, ssim, mse, d_image)
        for name, tensor in (("image", image), ("target", target)):
            check_array(name, tensor, torch.float32, (3, *image.shape[1:]), contiguous=False)
        d_image = torch.empty_like(image, memory_format=torch.contiguous_format)
        l1, ssim, mse = kernel.photometric_loss(
            image=plain(image),
            target=plain(target),
            gradient=d_image,
            ssim_weight=self.ssim_weight,
            mse_weight=self.mse_weight,
            share=share,
            threads=self.threads,
        )
        return LossValue(self._of(l1, ssim, mse), l1, ssim, mse, d_image)

    def _of(self, l1: float, ssim: float, mse: float) -> float:
        return (1 - self.ssim_weight) * l1 + self.ssim_weight * (1 - ssim) + self.mse_weight * mse
