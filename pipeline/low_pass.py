"""A temporal low-pass: what the 0.3 px² of dilation are to the pixel, this is to the frame.

Every Gaussian is rendered wider in time, st'² = st² + σ², and fainter by as much, α' = α st/st', so that its sum over
time stays (as Mip-Splatting's 3D filter does in space). One that lives shorter than the spacing of the frames can then
neither exist nor shine in a single one of them. The width is added along the Gaussian's own fourth axis: Σtt grows by
σ² × (its cosine with time)², and the marginal, the slice and the opacity all follow, being those of one 4D Gaussian.
What is stored and trained is st and α; what is rendered is st' and α'.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from rasterizer import Gaussians, Gradients


def low_passed(gaussians: Gaussians, sigma: float) -> Gaussians:
    """What is rendered of stored Gaussians. sigma: the filter's standard deviation, the scene's time unit."""
    wider, part = _widened(gaussians.log_scale[:, 3], sigma)
    log_scale = gaussians.log_scale.clone()
    log_scale[:, 3] = wider
    return replace(gaussians, log_scale=log_scale, opacity_logit=_fainter(gaussians.opacity_logit, part))


def carry_back(gradients: Gradients, stored: Gaussians, sigma: float) -> None:
    """Turn gradients with respect to what was rendered into those of what is stored, in place.

    With c = st/st': ∂log st'/∂log st = c²; α' = α c, so ∂logit α'/∂logit α = (1 - α)/(1 - α') and
    ∂logit α'/∂log st = (1 - c²)/(1 - α').
    """
    _, part = _widened(stored.log_scale[:, 3], sigma)
    opacity = torch.sigmoid(stored.opacity_logit)
    left = 1.0 - opacity * part  # 1 - α'
    d_logit = gradients.opacity_logit / left
    gradients.log_scale[:, 3] = gradients.log_scale[:, 3] * part**2 + d_logit * (1.0 - part**2)
    gradients.opacity_logit.copy_(d_logit * (1.0 - opacity))


def _widened(log_scale_t: Tensor, sigma: float) -> tuple[Tensor, Tensor]:
    """(log st', st/st') of log st, (N,) each."""
    ratio = sigma * torch.exp(-log_scale_t)  # σ/st
    growth = 0.5 * torch.log1p(ratio**2)
    return log_scale_t + growth, torch.exp(-growth)


def _fainter(logit: Tensor, part: Tensor) -> Tensor:
    """logit(α c) of logit(α): log(αc) - log(1 - αc), which keeps its digits for faint Gaussians."""
    return torch.nn.functional.logsigmoid(logit) + torch.log(part) - torch.log1p(-torch.sigmoid(logit) * part)
