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
    growth, log_scale = _growth(gaussians.log_scale[:, 3], sigma), gaussians.log_scale.clone()
    log_scale[:, 3] += growth
    log_opacity = torch.nn.functional.logsigmoid(gaussians.opacity_logit) - growth
    logit = log_opacity - torch.log(_see_through(gaussians.opacity_logit, growth))
    return replace(gaussians, log_scale=log_scale, opacity_logit=logit)


def carry_back(gradients: Gradients, stored: Gaussians, sigma: float) -> None:
    """Turn gradients with respect to what was rendered into those of what is stored, in place.

    With c = st/st': ∂log st'/∂log st = c²; α' = α c, so ∂logit α'/∂logit α = (1 - α)/(1 - α') and
    ∂logit α'/∂log st = (1 - c²)/(1 - α').
    """
    growth = _growth(stored.log_scale[:, 3], sigma)
    see_through = torch.sigmoid(-stored.opacity_logit)  # 1 - α
    d_logit = gradients.opacity_logit / _see_through(stored.opacity_logit, growth)
    part = torch.exp(-2.0 * growth)  # c²
    gradients.log_scale[:, 3] = gradients.log_scale[:, 3] * part - d_logit * torch.expm1(-2.0 * growth)
    gradients.opacity_logit.copy_(d_logit * see_through)


def _growth(log_scale_t: Tensor, sigma: float) -> Tensor:
    """log(st'/st) (N,)."""
    return 0.5 * torch.log1p((sigma * torch.exp(-log_scale_t)) ** 2)


def _see_through(logit: Tensor, growth: Tensor) -> Tensor:
    """1 - α' = (1 - α) + α (1 - st/st'), no difference of near equals: above zero for opaque Gaussians too."""
    return torch.sigmoid(-logit) - torch.sigmoid(logit) * torch.expm1(-growth)
