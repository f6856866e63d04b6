"""Reference implementation of alpha blending: splats to an image, front to back (docs/method.md 1.3).

Any floating-point type, differentiable. Notation: V splats, P pixels, C channels, T transmittance.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from rasterizer.camera import Camera

MAX_ALPHA = 0.99  # keeps 1 - α' away from zero (3DGS)
MIN_ALPHA = 1 / 255  # one level of an 8-bit image (3DGS)
MIN_TRANSMITTANCE = 1e-4  # a pixel ends before T falls below (3DGS)
MIN_MARGINAL = 0.05  # Gaussians with a smaller p(t) are culled: 2.4 σ from μt (docs/method.md 1.1)
CHUNK_ELEMENTS = 2**22  # splats × pixels blended at once: bounds the memory where no gradient is recorded


@dataclass(frozen=True)
class Thresholds:
    """Cut-offs below which contributions are skipped; all zero: none is."""

    min_marginal: float = MIN_MARGINAL
    min_alpha: float = MIN_ALPHA
    min_transmittance: float = MIN_TRANSMITTANCE


@dataclass(frozen=True)
class Splats:
    """The projected Gaussians in view, nearest first."""

    index: Tensor  # (V,) rows of the Gaussians
    center: Tensor  # (V, 2) pixels
    ellipse: Tensor  # (V, 3) (k, V, C) of the 2D covariance, as `reference.render.ellipse` defines them
    opacity: Tensor  # (V,) α p(t)
    features: Tensor  # (V, C) the channels to blend: colour, depth, …


def squared_distance(splats: Splats, pixels: Tensor) -> Tensor:
    """Squared Mahalanobis distance (V, P) of pixels (P, 2): dᵀ Σ2d⁻¹ d = (dx + k dy)²/V + dy²/C."""
    dx, dy = (pixels[None] - splats.center[:, None]).unbind(-1)
    shear, variance_x, variance_y = splats.ellipse[:, :, None].unbind(1)
    return (dx + shear * dy) ** 2 / variance_x + dy * dy / variance_y


def splat_alpha(splats: Splats, pixels: Tensor, min_alpha: float = MIN_ALPHA) -> Tensor:
    """α' (V, P) of splats at pixels (P, 2): min(0.99, α p(t) exp(-½ dᵀ Σ2d⁻¹ d)); zero below `min_alpha`."""
    distance_squared = squared_distance(splats, pixels)
    alpha = (splats.opacity[:, None] * torch.exp(-0.5 * distance_squared)).clamp(max=MAX_ALPHA)
    return torch.where(alpha < min_alpha, 0, alpha)


def blending_weights(alpha: Tensor, min_transmittance: float = MIN_TRANSMITTANCE) -> tuple[Tensor, Tensor]:
    """Weights w_i = α'_i Π_j<i (1 - α'_j) (V, P) and the final transmittance T (P,), from α' (V, P) front to back.

    The first contribution that would bring T below `min_transmittance` ends its pixel and is not blended. T only
    decreases, so the contributions before it are those whose running product is still at least `min_transmittance`.
    """
    after = torch.cumprod(1 - alpha, dim=0)
    before = torch.cat([torch.ones_like(after[:1]), after[:-1]]) if len(alpha) else after
    blended = after >= min_transmittance
    weight = torch.where(blended, alpha * before, 0)
    return weight, torch.where(blended, 1 - alpha, 1).prod(dim=0)


def pixel_centers(camera: Camera, dtype: torch.dtype) -> Tensor:
    """Pixel centres (H, W, 2): (column + ½, row + ½)."""
    rows, columns = torch.meshgrid(torch.arange(camera.height), torch.arange(camera.width), indexing="ij")
    return torch.stack([columns, rows], dim=-1).to(dtype) + 0.5


def blend(splats: Splats, camera: Camera, thresholds: Thresholds = Thresholds()) -> tuple[Tensor, Tensor]:
    """Σ w · features (C, H, W) and the final transmittance (H, W), one band of rows at a time."""
    band = max(1, CHUNK_ELEMENTS // max(1, len(splats.index) * camera.width))
    sums, transmittances = [], []
    for pixels in pixel_centers(camera, splats.center.dtype).split(band):
        alpha = splat_alpha(splats, pixels.reshape(-1, 2), thresholds.min_alpha)
        weight, transmittance = blending_weights(alpha, thresholds.min_transmittance)
        sums.append((splats.features.T @ weight).reshape(-1, *pixels.shape[:2]))
        transmittances.append(transmittance.reshape(pixels.shape[:2]))
    return torch.cat(sums, dim=1), torch.cat(transmittances)
