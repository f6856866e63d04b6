"""4D Gaussians as a viewer draws them: conditioned on time, each is a 3D Gaussian that moves on a line and fades.

With Σ = M Mᵀ as in docs/method.md 1.1, none of this is an approximation:

    mean at t        μ_xyz + velocity (t - μt),   velocity = Σ_xyz,t / Σtt
    covariance       A Aᵀ, constant in time       = R diag(scale²) Rᵀ
    opacity at t     opacity · exp(-½ (t - μt)²/Σtt), zero where the exponential is below 0.05
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from pipeline.model.model import Model
from rasterizer.gaussians import SH_LAYOUTS
from rasterizer.reference.blend import MIN_ALPHA, MIN_MARGINAL
from rasterizer.reference.render import slice_in_time

LIFETIME = math.sqrt(-2 * math.log(MIN_MARGINAL))  # half of it, in standard deviations: 2.45


@dataclass(frozen=True)
class Trajectories:
    """N Gaussians; float64 arrays. In a static model velocity, mean_t and sigma_t are None."""

    mean: np.ndarray  # (N, 3) at the time mean_t
    scale: np.ndarray  # (N, 3) standard deviations along the axes of `rotation`
    rotation: np.ndarray  # (N, 3) axis × angle, radians
    opacity_logit: np.ndarray  # (N,)
    sh: np.ndarray  # (N, orders, coefficients, 3) float32
    velocity: np.ndarray | None  # (N, 3) units of length a unit of time
    mean_t: np.ndarray | None  # (N,)
    sigma_t: np.ndarray | None  # (N,)


def trajectories(model: Model) -> Trajectories:
    """The Gaussians of `model` that reach an alpha of 1/255 at some time; nothing else is ever drawn."""
    gaussians = model.gaussians()
    gaussians = gaussians.rows(gaussians.opacity_logit > math.log(MIN_ALPHA / (1 - MIN_ALPHA)))
    coefficients, orders = SH_LAYOUTS[gaussians.sh.shape[1]]
    sh = gaussians.sh.reshape(-1, orders, coefficients, 3).numpy()
    gaussians = gaussians.to(torch.float64)
    sliced = slice_in_time(gaussians, 0.0)
    mean, logit = gaussians.mean.numpy(), gaussians.opacity_logit.numpy()
    axes = _axes(sliced.factor.numpy())
    if sliced.variance_t is None:
        return Trajectories(mean, *axes, logit, sh, None, None, None)
    return Trajectories(
        mean[:, :3], *axes, logit, sh, sliced.velocity.numpy(), mean[:, 3], sliced.variance_t.sqrt().numpy()
    )


def _axes(factor: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Scale (N, 3) and rotation (N, 3) of the covariances A Aᵀ, from A (N, 3, k)."""
    variance, directions = np.linalg.eigh(factor @ factor.transpose(0, 2, 1))
    directions[:, :, 0] *= np.sign(np.linalg.det(directions))[:, None]  # a rotation, not a reflection
    return np.sqrt(np.maximum(variance, 0)), Rotation.from_matrix(directions).as_rotvec()
