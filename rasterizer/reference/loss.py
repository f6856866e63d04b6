"""Reference implementation of the photometric loss: L1, SSIM and MSE of two images, differentiable, of any type."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

RADIUS, SIGMA = 5, 1.5  # of SSIM's Gaussian window, pixels: 11 × 11
C1, C2 = 0.01**2, 0.03**2  # SSIM's constants at data range 1


def photometric_terms(image: Tensor, target: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """(L1, SSIM, MSE), means over images (3, H, W) in [0, 1]. SSIM is 3DGS's: its windows see zeros outside."""
    mu_x, mu_y, xx, yy, xy = blurred(torch.stack([image, target, image * image, target * target, image * target]))
    var_x, var_y, covariance = xx - mu_x**2, yy - mu_y**2, xy - mu_x * mu_y
    ssim = ((2 * mu_x * mu_y + C1) * (2 * covariance + C2)) / ((mu_x**2 + mu_y**2 + C1) * (var_x + var_y + C2))
    error = image - target
    return error.abs().mean(), ssim.mean(), (error * error).mean()


def blurred(images: Tensor) -> Tensor:
    """(B, C, H, W) images under the window, column after row."""
    offset = torch.arange(-RADIUS, RADIUS + 1, dtype=images.dtype, device=images.device)
    bell = torch.exp(-0.5 * (offset / SIGMA) ** 2)
    window = (bell / bell.sum()).expand(1, 1, 1, -1)
    flat = images.flatten(0, 1)[:, None]
    across = F.conv2d(flat, window, padding=(0, RADIUS))
    return F.conv2d(across, window.mT, padding=(RADIUS, 0)).view(images.shape)
