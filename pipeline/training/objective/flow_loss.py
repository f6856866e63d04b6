"""The flow loss, of ours and not of the paper: the rendered optical flow against that measured in the images.

Photometric gradients move what is there towards where it should be; they hardly tell a Gaussian that moves from a row
of Gaussians that appear one after another. Measured flow does.
"""

from __future__ import annotations

import torch
from torch import Tensor

SOFTENING = 1e-3  # image widths: errors above count by their length, smaller ones by their square


def flow_loss(flow: Tensor, measured: Tensor, weight: float, alpha: Tensor | None = None) -> tuple[float, Tensor]:
    """(loss, weight × ∂loss/∂flow (2, H, W)): the mean over all pixels of √(|error|² + ε²) - ε, in image widths.

    flow: (2, H, W), rendered, in pixels. measured: (2, H, W), in image widths; NaN where there is none, which has no
    loss. alpha: (1, H, W), of the Gaussians: rendered flow is a sum over their weights, so it is compared with as large
    a part of the measured one. None: with all of it, for cameras that stand still, whose background has no flow.
    """
    height, width = flow.shape[1:]
    error = torch.nan_to_num(flow / width - (measured if alpha is None else alpha * measured), nan=0.0)
    length = torch.sqrt((error * error).sum(dim=0, keepdim=True) + SOFTENING**2)
    loss = (length - SOFTENING).mean().item()
    return loss, error * (weight / (height * width * width)) / length
