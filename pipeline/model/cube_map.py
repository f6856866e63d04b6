"""A learned cube map of the sky: the colour infinitely far away, seen where alpha is below 1.

Six faces of r × r texels around the viewer. A unit direction d belongs to the face of its longest component, axis a:
face 2a if d_a > 0, else 2a + 1. With b, c the axes after a in the cycle x, y, z, texel (row j, column i) is centred at
d_b / |d_a| = (2i + 1) / r - 1, d_c / |d_a| = (2j + 1) / r - 1.

Sampling is bilinear across the edges of faces, as graphics hardware does it: each face is bordered by the adjacent
texels of its neighbours, and by the mean of the three texels around each corner of the cube. Colours are continuous on
the whole sphere, and the gradient is that of the same weights.

Letters: (H, W) pixels of a view, r the resolution, P = r + 2 the side of a bordered face.
"""

from __future__ import annotations

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from pipeline.model.environment_map import INITIAL_COLOR, EnvironmentMap
from rasterizer import Camera

FACES = 6
_BILINEAR, _BORDER = 0, 1  # of grid_sampler_2d's enumerations
_OVER_THE_EDGE = 1 + 1e-6  # face coordinate of a texel just beyond an edge


class CubeMap:
    """image: (3, 6, r, r) float32, RGB; not clamped to [0, 1]. Raises ValueError for another shape or type.

    It is used like environment_map.EnvironmentMap.
    """

    def __init__(self, image: Tensor) -> None:
        side = image.shape[-1] if image.dim() == 4 else -1
        if image.dtype != torch.float32 or list(image.shape) != [3, FACES, side, side] or side < 1:
            raise ValueError(f"cube map: expected float32 [3, 6, r, r], found {image.dtype} {list(image.shape)}")
        self.image = image.contiguous()
        self._border = tuple(index.to(image.device) for index in border_index(side))

    @classmethod
    def grey(cls, resolution: int) -> CubeMap:
        """The initial map: INITIAL_COLOR everywhere."""
        return cls(torch.full((3, FACES, resolution, resolution), INITIAL_COLOR))

    @property
    def bytes(self) -> int:
        return self.image.numel() * self.image.element_size()

    @property
    def resolution(self) -> int:
        return self.image.shape[-1]

    def sample(self, grid: Tensor) -> Tensor:
        """(3, H, W) colour of each pixel's direction. grid: (H, W, 2) by `self.grid(camera)`."""
        return F.grid_sample(self._atlas()[None], grid[None], "bilinear", "border", align_corners=False)[0]

    def add_gradient(self, gradient: Tensor, grid: Tensor, d_colors: Tensor) -> None:
        """Add ∂L/∂image to `gradient` (3, 6, r, r), in place. d_colors: (3, H, W) ∂L/∂`sample(grid)`."""
        side = self.resolution + 2
        shape = self.image.new_empty(1, 3, FACES * side, side)  # only its shape is read
        d_atlas, _ = torch.ops.aten.grid_sampler_2d_backward(
            d_colors[None], shape, grid[None], _BILINEAR, _BORDER, False, (True, False)
        )
        faces = d_atlas[0].view(3, FACES, side, side)
        for row, column in _CORNERS:  # a corner is the mean of three texels, two of which are of the border
            third = faces[:, :, row, column] / 3
            for at_row, at_column in ((_inner(row), column), (row, _inner(column)), (_inner(row), _inner(column))):
                faces[:, :, at_row, at_column] += third
        gradient += faces[:, :, 1:-1, 1:-1]
        flat = gradient.view(3, -1)
        for edge, index in zip(_edges(faces), self._border):
            flat.index_add_(1, index.reshape(-1), edge.reshape(3, -1))

    def grid(self, camera: Camera) -> Tensor:
        """(H, W, 2) float32 position of each pixel centre's direction among the bordered faces, which are stacked from
        face 0 down: (column, row) in [-1, 1] from edge to edge, as torch's grid_sample takes it."""
        rotation = camera.world_to_cam[:3, :3]
        right = (np.arange(camera.width) + 0.5 - camera.cx) / camera.fx
        down = ((np.arange(camera.height) + 0.5 - camera.cy) / camera.fy)[:, None]
        return self._grid(
            np.stack([rotation[0, k] * right + (rotation[1, k] * down + rotation[2, k]) for k in range(3)])
        )

    def equirectangular(self, height: int) -> EnvironmentMap:
        """The same colours as a map of height × 2 height texels, sampled at their centres; for viewers."""
        latitude = (np.pi * ((np.arange(height) + 0.5) / height - 0.5))[:, None]
        azimuth = 2 * np.pi * ((np.arange(2 * height) + 0.5) / (2 * height) - 0.5)
        flat = np.cos(latitude)
        direction = np.stack([flat * np.sin(azimuth), np.sin(latitude) + 0 * azimuth, flat * np.cos(azimuth)])
        return EnvironmentMap(self.sample(self._grid(direction)))

    def _grid(self, direction: np.ndarray) -> Tensor:
        """(H, W, 2) by directions (3, H, W), as `grid`."""
        face, across, along = face_coordinates(direction)
        r = self.resolution
        column = 2 * (1 + 0.5 * (across + 1) * r) / (r + 2) - 1
        row = 2 * (face * (r + 2) + 1 + 0.5 * (along + 1) * r) / (FACES * (r + 2)) - 1
        return torch.from_numpy(np.stack([column, row], axis=-1).astype(np.float32)).to(self.image.device)

    def _atlas(self) -> Tensor:
        """(3, 6 P, P): the bordered faces, one below the other."""
        faces = F.pad(self.image, (1, 1, 1, 1))
        flat = self.image.view(3, -1)
        for edge, index in zip(_edges(faces), self._border):
            edge.copy_(flat[:, index.reshape(-1)].view(3, FACES, -1))
        for row, column in _CORNERS:
            beside = faces[:, :, _inner(row), column] + faces[:, :, row, _inner(column)]
            faces[:, :, row, column] = (beside + faces[:, :, _inner(row), _inner(column)]) / 3
        return faces.reshape(3, -1, self.resolution + 2)


_CORNERS = ((0, 0), (0, -1), (-1, 0), (-1, -1))


def _inner(index: int) -> int:
    """The row or column of the face itself beside that of the border."""
    return 1 if index == 0 else -2


def _edges(faces: Tensor) -> tuple[Tensor, ...]:
    """The border of bordered faces (3, 6, P, P) without its corners: left, right, first row, last row, (3, 6, r)."""
    return faces[:, :, 1:-1, 0], faces[:, :, 1:-1, -1], faces[:, :, 0, 1:-1], faces[:, :, -1, 1:-1]


def face_coordinates(direction: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(face, d_b / |d_a|, d_c / |d_a|) of directions (3, …)."""
    axis = np.abs(direction).argmax(axis=0)
    main, second, third = (np.take_along_axis(direction, ((axis + k) % 3)[None], axis=0)[0] for k in range(3))
    length = np.abs(main)
    return 2 * axis + (main < 0), second / length, third / length


def border_index(resolution: int) -> tuple[Tensor, ...]:
    """For each of `_edges` the adjacent texels (6, r) int64, as indices into the flattened faces."""
    centre = (2 * np.arange(resolution) + 1) / resolution - 1
    over = np.full(resolution, _OVER_THE_EDGE)
    found = []
    for across, along in ((-over, centre), (over, centre), (centre, -over), (centre, over)):
        texels = []
        for face in range(FACES):
            direction = np.empty((3, resolution))
            direction[face // 2] = -1.0 if face % 2 else 1.0
            direction[(face // 2 + 1) % 3], direction[(face // 2 + 2) % 3] = across, along
            other, b, c = face_coordinates(direction)
            column, row = (np.clip((0.5 * (x + 1) * resolution).astype(int), 0, resolution - 1) for x in (b, c))
            texels.append((other * resolution + row) * resolution + column)
        found.append(torch.from_numpy(np.stack(texels).astype(np.int64)))
    return tuple(found)
