"""What a rasterizer returns."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

OUTPUT_NAMES = ("color", "alpha", "depth", "flow", "stats")


@dataclass(frozen=True)
class RenderOutput:
    """Images of one view; those not asked for are None.

    With w the blending weight of a Gaussian at a pixel:
    """

    color: Tensor | None  # (3, H, W) Σ w c + T background
    alpha: Tensor | None = None  # (1, H, W) 1 - T
    depth: Tensor | None = None  # (1, H, W) Σ w z, world units along the viewing axis
    flow: Tensor | None = None  # (2, H, W) Σ w (proj(μ(t+δ)) - proj(μ(t))), pixels right and down
    stats: Tensor | None = None  # (2, H, W) Σ w μt and Σ w Σtt
