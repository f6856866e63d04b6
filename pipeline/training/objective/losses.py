"""The loss of a batch: the mean over its views of (1 - w) L1 + w (1 - SSIM) + `mse_weight` × MSE, w = 0.2.

3DGS and the paper have no MSE. `train.mse_weight` is ours.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from rasterizer.loss import LossValue, PhotometricLoss


def view_loss(criterion: PhotometricLoss, image: Tensor, target: Tensor, batch: int) -> LossValue:
    """The loss of one view of a batch of `batch` views; `d_image` is ∂(batch loss)/∂image. image, target: (3, H, W).

    The image is not clamped, so that pixels above 1 have a gradient.
    """
    return criterion(image, target, share=1.0 / batch)


def psnr(image: Tensor, target: Tensor) -> float:
    """PSNR of the clamped image in dB, infinite for equal images; for the progress bar, not for results."""
    error = torch.mean((image.clamp(0.0, 1.0) - target) ** 2).item()
    return math.inf if error == 0 else -10.0 * math.log10(error)
