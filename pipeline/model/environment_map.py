"""A learned equirectangular environment map: the colour infinitely far away, seen where alpha is below 1.

Texel (column i, row j) of h rows and 2h columns covers azimuths 2π (i/2h - ½) to 2π ((i+1)/2h - ½) and latitudes
π (j/h - ½) to π ((j+1)/h - ½). Azimuth is atan2(x, z), latitude asin(y) of the unit direction (x, y, z) in the world:
+z is the middle of the map, +x to its right, +y its lower edge. The poles are on y because the axes of scenes with an
open background are a camera's (COLMAP's y down or LLFF's y up). Cameras then look along ±z, and the poles, where texels
are narrow, are seldom visible.

Letters: (H, W) pixels of a view, (h, 2h) texels.
"""

from __future__ import annotations

import math

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from rasterizer import Camera

# The middle of the colour range, where Gaussians start too; the release starts from black, twice as far from white.
# Texels that no camera sees keep it.
INITIAL_COLOR = 0.5

_BILINEAR, _BORDER = 0, 1  # of grid_sampler_2d's enumerations


class EnvironmentMap:
    """image: (3, h, 2h) float32, RGB; not clamped to [0, 1]. Raises ValueError for another shape or type."""

    def __init__(self, image: Tensor) -> None:
        height = image.shape[1] if image.dim() == 3 else -1
        if image.dtype != torch.float32 or list(image.shape) != [3, height, 2 * height]:
            raise ValueError(f"environment map: expected float32 [3, h, 2h], found {image.dtype} {list(image.shape)}")
        self.image = image.contiguous()

    @classmethod
    def grey(cls, height: int) -> EnvironmentMap:
        """The initial map: INITIAL_COLOR everywhere."""
        return cls(torch.full((3, height, 2 * height), INITIAL_COLOR))

    @property
    def bytes(self) -> int:
        return self.image.numel() * self.image.element_size()

    def sample(self, grid: Tensor) -> Tensor:
        """(3, H, W) colour of each pixel's direction, bilinear; azimuth wraps, latitude is clamped to the centres of
        the first and last row. grid: (H, W, 2) by `self.grid(camera)`."""
        return F.grid_sample(self._wrapped(), grid[None], "bilinear", "border", align_corners=False)[0]

    def add_gradient(self, gradient: Tensor, grid: Tensor, d_colors: Tensor) -> None:
        """Add ∂L/∂image to `gradient` (3, h, 2h), in place. d_colors: (3, H, W) ∂L/∂`sample(grid)`.

        The bits do not depend on the number of threads: torch computes this gradient of a single image on one.
        """
        # Autograd's own function, called directly: autograd would also differentiate the wrapping and copy the map.
        # Sampling and gradient take 5 ms instead of 11 (400 × 400 pixels, h = 500, one thread). Only the shape of
        # `wrapped` is read.
        _, height, columns = self.image.shape
        wrapped = self.image.new_empty(1, 3, height, columns + 2)
        d_wrapped, _ = torch.ops.aten.grid_sampler_2d_backward(
            d_colors[None], wrapped, grid[None], _BILINEAR, _BORDER, False, (True, False)
        )
        gradient += d_wrapped[0, :, :, 1:-1]
        gradient[:, :, -1] += d_wrapped[0, :, :, 0]
        gradient[:, :, 0] += d_wrapped[0, :, :, -1]

    def grid(self, camera: Camera) -> Tensor:
        """(H, W, 2) float32 position of each pixel centre's direction in the wrapped map: (column, row) in [-1, 1] from
        edge to edge, as torch's grid_sample takes it.

        It is cheap and takes memory, so it is not cached. It is computed in numpy, because the rounding of torch's
        atan2 depends on the number of threads.
        """
        rotation = camera.world_to_cam[:3, :3].astype(np.float32)
        right = ((np.arange(camera.width) + 0.5 - camera.cx) / camera.fx).astype(np.float32)
        down = ((np.arange(camera.height) + 0.5 - camera.cy) / camera.fy).astype(np.float32)[:, None]
        x, y, z = (rotation[0, k] * right + (rotation[1, k] * down + rotation[2, k]) for k in range(3))  # Rᵀ ray
        columns = self.image.shape[2]
        azimuth = np.arctan2(x, z) * (columns / (columns + 2) / math.pi)  # the wrapped map is 2 columns wider
        latitude = np.arctan2(y, np.sqrt(x * x + z * z)) * (2 / math.pi)
        return torch.from_numpy(np.stack([azimuth, latitude], axis=-1)).to(self.image.device)

    def _wrapped(self) -> Tensor:
        """(1, 3, h, 2h + 2): circular padding by one column on each side."""
        return torch.cat([self.image[:, :, -1:], self.image, self.image[:, :, :1]], dim=2)[None]
