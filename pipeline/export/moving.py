"""3D Gaussians that move on lines and fade: what the temporal splat formats hold.

The conditional covariance of a 4D Gaussian does not depend on time, its conditional mean is linear in it, and its
opacity is a Gaussian of it (docs/method.md 1.1). Only colours that change with time do not fit. Each Gaussian has
its mean colour instead, over the times at which it is seen, weighted by p(t).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from pipeline.export.frame import constant_colour, scales_and_rotation
from pipeline.model.model import Model
from rasterizer.reference.blend import MIN_ALPHA, MIN_MARGINAL
from rasterizer.reference.render import opacity, slice_in_time
from rasterizer.reference.sh import fourier_basis

REACH = float(np.sqrt(-2 * np.log(MIN_MARGINAL)))  # p(t) < 0.05 further than this many σt from μt
QUADRATURE = 32  # times at which the mean colour is sampled, evenly over those at which a Gaussian is seen


@dataclass(frozen=True)
class MovingGaussians:
    """N Gaussians, float64. At time t: mean + velocity (t - time), opacity × exp(-½ ((t - time)/sigma)²)."""

    mean: Tensor  # (N, 3) at `time`
    velocity: Tensor  # (N, 3) per unit of time
    log_scale: Tensor  # (N, 3)
    quat: Tensor  # (N, 4) unit, wxyz
    opacity: Tensor  # (N,) in (0, 1)
    sh: Tensor  # (N, (l+1)², 3) without time
    time: Tensor  # (N,) μt
    sigma: Tensor  # (N,) √Σtt

    def __len__(self) -> int:
        return len(self.mean)


def moving_gaussians(model: Model, time_start: float, duration: float) -> MovingGaussians:
    """Those of a model that are seen at any time of the scene. ValueError for a static model."""
    if model.kind.motion == "static":
        raise ValueError("expected a model with time, found a static one; export it as ply, splat, spz or glb")
    gaussians = model.gaussians().to(torch.float64)
    sliced = slice_in_time(gaussians, time_start)
    assert sliced.variance_t is not None
    time, sigma, alpha = gaussians.mean[:, 3], sliced.variance_t.sqrt(), opacity(gaussians.opacity_logit)
    nearest = time.clamp(time_start, time_start + duration)
    marginal = torch.exp(-0.5 * ((nearest - time) / sigma) ** 2)
    seen = (marginal >= MIN_MARGINAL) & (alpha * marginal >= MIN_ALPHA)
    time, sigma = time[seen], sigma[seen]
    log_scale, quat = scales_and_rotation(sliced.factor[seen])
    weights = mean_fourier_basis(time, sigma, time_start, duration, model.kind.fourier_order)
    return MovingGaussians(
        gaussians.mean[seen, :3],
        sliced.velocity[seen],
        log_scale,
        quat,
        alpha[seen],
        constant_colour(model, gaussians.sh[seen], weights),
        time,
        sigma,
    )


def mean_fourier_basis(time: Tensor, sigma: Tensor, time_start: float, duration: float, order: int) -> Tensor:
    """(N, order + 1): the mean of cos(2πn (t - μt)/T) over the times t of the scene with p(t) >= 0.05, weighted by
    p(t)."""
    first = (time - REACH * sigma).clamp_min(time_start)
    last = (time + REACH * sigma).clamp_max(time_start + duration)
    share = (torch.arange(QUADRATURE, dtype=time.dtype) + 0.5) / QUADRATURE
    elapsed = first[:, None] + (last - first)[:, None] * share - time[:, None]
    weight = torch.exp(-0.5 * (elapsed / sigma[:, None]) ** 2)
    basis = fourier_basis(elapsed.flatten(), duration, order).unflatten(0, elapsed.shape)
    return (weight[:, :, None] * basis).sum(dim=1) / weight.sum(dim=1, keepdim=True)
