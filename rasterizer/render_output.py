"""`RenderOutput`: the images that the rasterizer returns, and how many channels each has."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

OUTPUT_CHANNELS = {"color": 3, "alpha": 1, "depth": 1, "flow": 2, "stats": 2}
OUTPUT_NAMES = tuple(OUTPUT_CHANNELS)


@dataclass(frozen=True)
class RenderOutput:
    """Images of one view; outputs that were not requested are None.

    Sums go over the Gaussians at a pixel, with w the blending weight and T the transmittance behind the last one:
    """

    color: Tensor | None  # (3, H, W) Σ w c + T background
    alpha: Tensor | None = None  # (1, H, W) 1 - T
    depth: Tensor | None = None  # (1, H, W) Σ w z, world units along the optical axis
    flow: Tensor | None = None  # (2, H, W) Σ w (proj(μ(t+δ)) - proj(μ(t))), pixels right and down
    stats: Tensor | None = None  # (2, H, W) Σ w μt and Σ w Σtt
