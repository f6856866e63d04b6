"""The loss of a batch: the mean over its views of (1 - w) L1 + w (1 - SSIM), w = `train.ssim_weight` (3DGS)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from rasterizer.loss import L1Ssim


@dataclass(frozen=True)
class ViewLoss:
    """The loss of one view, and what it contributes to the gradient of the batch."""

    loss: float
    l1: float
    ssim: float
    d_image: Tensor  # (3, H, W) ∂(batch loss)/∂image, so already divided by the batch's size


def view_loss(criterion: L1Ssim, image: Tensor, target: Tensor, batch: int) -> ViewLoss:
    """image, target: (3, H, W). The image is not clamped: a pixel too bright must still be pulled back."""
    value = criterion(image, target, share=1.0 / batch)
    return ViewLoss(value.loss, value.l1, value.ssim, value.d_image)


def psnr(image: Tensor, target: Tensor) -> float:
    """Of the clamped image, in dB; infinite where equal. For the progress display; metrics.py is what counts."""
    error = torch.mean((image.clamp(0.0, 1.0) - target) ** 2).item()
    return math.inf if error == 0 else -10.0 * math.log10(error)
