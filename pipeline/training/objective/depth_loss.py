"""The losses on the rendered depth: known depths of some pixels, and the sky, which has none (docs/urban.md).

All of them are of the inverse depth of a pixel, ρ = α² / D with D = Σ w z and α = Σ w: opacity times the inverse of the
mean depth D / α. What is behind the Gaussians, the cube map, is at infinite distance and adds nothing. ρ and its
gradient are finite for any opacity, where 1 / D is not.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from pipeline.data.lidar.depth_targets import SparseDepth

SMALLEST_DEPTH = 1e-6  # of D: below it a pixel shows nothing, and ρ is 0


@dataclass(frozen=True)
class DepthGradient:
    """A loss with its gradients by the rendered depth D and α, (1, H, W) each."""

    loss: float
    d_depth: Tensor
    d_alpha: Tensor

    def __add__(self, other: DepthGradient) -> DepthGradient:
        return DepthGradient(self.loss + other.loss, self.d_depth + other.d_depth, self.d_alpha + other.d_alpha)


def inverse_depth(depth: Tensor, alpha: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """(ρ, ∂ρ/∂D, ∂ρ/∂α) of tensors of one shape."""
    known = depth > SMALLEST_DEPTH
    share = torch.where(known, alpha / depth.clamp_min(SMALLEST_DEPTH), 0.0)
    return alpha * share, -share * share, 2 * share


def sparse_depth_loss(depth: Tensor, alpha: Tensor, target: SparseDepth, weight: float) -> DepthGradient:
    """weight × the mean of |ρ - 1 / z| over the pixels with a known depth z. depth, alpha: (1, H, W), rendered."""
    at = target.pixel
    rho, by_depth, by_alpha = inverse_depth(depth.reshape(-1)[at], alpha.reshape(-1)[at])
    error = rho - target.inverse
    slope = torch.sign(error) * (weight / len(at))
    d_depth, d_alpha = torch.zeros_like(depth), torch.zeros_like(alpha)
    d_depth.view(-1)[at] = slope * by_depth
    d_alpha.view(-1)[at] = slope * by_alpha
    return DepthGradient(weight * error.abs().mean().item(), d_depth, d_alpha)


def sky_loss(depth: Tensor, alpha: Tensor, sky: Tensor, weight: float) -> DepthGradient:
    """weight × mean of ρ over the sky, as in the paper.

    sky: (1, H, W) in [0, 1], the share of each pixel that is sky; the mean is weighted by it.
    """
    share = sky / sky.sum().clamp_min(1.0)
    rho, by_depth, by_alpha = inverse_depth(depth, alpha)
    loss = weight * (share * rho).sum()
    return DepthGradient(loss.item(), weight * share * by_depth, share * (weight * by_alpha))
