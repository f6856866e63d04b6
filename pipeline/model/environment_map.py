"""A learned picture of what is infinitely far: the colour a pixel has where no Gaussian covers it.

The picture is equirectangular. Texel (column i, row j) of h rows and 2h columns covers the directions of azimuth
2π (i/2h - ½) to 2π ((i+1)/2h - ½) and of latitude π (j/h - ½) to π ((j+1)/h - ½); azimuth is atan2(x, z), latitude
asin(y) of the unit direction (x, y, z) in the world. So world +z is its middle, +x right of it, +y its lower edge.
The poles are on y because what films an open background is oriented like a camera, COLMAP's y down or LLFF's y up:
cameras look along ±z, and the poles, where texels are thin and the picture does not wrap, are seldom seen.

Letters: (H, W) pixels of a view, (h, 2h) texels.
"""

from __future__ import annotations

import math

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from rasterizer import Camera

# Halfway to every colour, as a Gaussian starts too; black, the release's start, is twice as far from white. What no
# camera ever sees keeps it.
START = 0.5

_BILINEAR, _BORDER = 0, 1  # of grid_sampler_2d's enumerations


class EnvironmentMap:
    """The picture, (3, h, 2h) float32, RGB as images are; nothing clamps it to [0, 1]."""

    def __init__(self, image: Tensor) -> None:
        height = image.shape[1] if image.dim() == 3 else -1
        if image.dtype != torch.float32 or list(image.shape) != [3, height, 2 * height]:
            raise ValueError(f"environment: expected float32 [3, h, 2h], found {image.dtype} {list(image.shape)}")
        self.image = image.contiguous()

    @classmethod
    def grey(cls, height: int) -> EnvironmentMap:
        """The start of training: one colour everywhere."""
        return cls(torch.full((3, height, 2 * height), START))

    def copy(self) -> EnvironmentMap:
        return EnvironmentMap(self.image.clone())

    @property
    def bytes(self) -> int:
        return self.image.numel() * self.image.element_size()

    def look_up(self, grid: Tensor) -> Tensor:
        """(3, H, W) colour at each pixel's place in the picture, bilinear: azimuth wraps round, latitude ends at the
        first and last rows' centres. grid: `self.grid(camera)`."""
        return F.grid_sample(self._wrapped(), grid[None], "bilinear", "border", align_corners=False)[0]

    def add_gradient(self, gradient: Tensor, grid: Tensor, d_colors: Tensor) -> None:
        """Add to `gradient` (3, h, 2h) what ∂L/∂`look_up(grid)`, (3, H, W), says of the texels.

        The same for any number of threads: torch spreads one picture's gradient on one.
        """
        # What autograd would call, which also passes back through the wrapping and copies the picture for it: look-up
        # and gradient take 5 ms so, 11 by autograd (400 × 400 pixels, h = 500, one thread). Of the picture it reads
        # only the shape.
        _, height, columns = self.image.shape
        wrapped = self.image.new_empty(1, 3, height, columns + 2)
        spread, _ = torch.ops.aten.grid_sampler_2d_backward(
            d_colors[None], wrapped, grid[None], _BILINEAR, _BORDER, False, (True, False)
        )
        gradient += spread[0, :, :, 1:-1]
        gradient[:, :, -1] += spread[0, :, :, 0]
        gradient[:, :, 0] += spread[0, :, :, -1]

    def grid(self, camera: Camera) -> Tensor:
        """(H, W, 2) where in the wrapped picture each pixel's centre looks: column, row in [-1, 1] from edge to edge.

        Made anew for each view: cheap, where kept for all cameras it would take memory. In numpy: how torch's atan2
        rounds depends on the number of threads.
        """
        rotation = camera.world_to_cam[:3, :3].astype(np.float32)
        right = ((np.arange(camera.width) + 0.5 - camera.cx) / camera.fx).astype(np.float32)
        down = ((np.arange(camera.height) + 0.5 - camera.cy) / camera.fy).astype(np.float32)[:, None]
        x, y, z = (rotation[0, k] * right + (rotation[1, k] * down + rotation[2, k]) for k in range(3))  # Rᵀ ray
        columns = self.image.shape[2]
        azimuth = np.arctan2(x, z) * (columns / (columns + 2) / math.pi)  # the wrapped picture is 2 columns wider
        latitude = np.arctan2(y, np.sqrt(x * x + z * z)) * (2 / math.pi)
        return torch.from_numpy(np.stack([azimuth, latitude], axis=-1))

    def _wrapped(self) -> Tensor:
        """(1, 3, h, 2h + 2): the last column again before the first, and the first after the last."""
        return torch.cat([self.image[:, :, -1:], self.image, self.image[:, :, :1]], dim=2)[None]
