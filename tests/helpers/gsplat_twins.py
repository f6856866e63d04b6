"""gsplat on the CPU: its `rasterization` with the CUDA functions replaced by PyTorch twins.

That of projection is gsplat's own (gsplat/cuda/_torch_impl.py), here with what ProjectionEWA3DGSFused.cu culls besides.
Its twin of blending needs CUDA; `blend` is the loop of RasterizeToPixels3DGSFwd.cu. It takes the whole image
for one tile, which is the same: what is not in a tile has α' below 1/255 there.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from unittest.mock import patch

import torch
from torch import Tensor

MAX_ALPHA, MIN_ALPHA, MIN_TRANSMITTANCE = 0.999, 1 / 255, 1e-4  # of RasterizeToPixels3DGSFwd.cu
UNDEFINED = -12345.0  # CUDA leaves what it culls as it was in memory


@contextmanager
def gsplat_on_the_cpu() -> Iterator[None]:
    """Within it gsplat.rasterization runs without CUDA, differentiable by autograd, in any floating-point type."""
    import gsplat.rendering

    with (
        patch.object(gsplat.rendering, "fully_fused_projection", project),
        patch.object(gsplat.rendering, "isect_tiles", sort),
        patch.object(gsplat.rendering, "isect_offset_encode", one_tile),
        patch.object(gsplat.rendering, "rasterize_to_pixels", blend),
    ):
        yield


def project(means, covars, quats, scales, viewmats, intrinsics, width, height, *, opacities, near_plane, **named):
    from gsplat.cuda._torch_impl import _fully_fused_projection

    assert quats is None and scales is None and not named.pop("packed") and not named.pop("sparse_grad")
    assert named.pop("radius_clip") == 0.0
    full = covars[..., [0, 1, 2, 1, 3, 4, 2, 4, 5]].unflatten(-1, (3, 3))
    radii, means2d, depths, conics, compensations = _fully_fused_projection(
        means, full, viewmats, intrinsics, width, height, near_plane=near_plane, **named
    )
    radii[:, opacities < MIN_ALPHA] = 0
    seen = (radii > 0).all(dim=-1)
    means2d, conics = (torch.where(seen[..., None], tensor, UNDEFINED) for tensor in (means2d, conics))
    return radii, means2d, torch.where(seen, depths, UNDEFINED), conics, compensations


def sort(means2d, radii, depths, *tiles, **named):
    """(-, -, rows of what is seen, nearest first; equal depths by row)"""
    seen = torch.nonzero((radii[0] > 0).all(dim=-1)).squeeze(1)
    return None, None, seen[torch.argsort(depths[0, seen].detach().float(), stable=True)]


def one_tile(isect_ids, images: int, width: int, height: int) -> Tensor:
    return torch.zeros(images, height, width)


def blend(
    means2d: Tensor,  # (1, N, 2)
    conics: Tensor,  # (1, N, 3)
    colors: Tensor,  # (1, N, D)
    opacities: Tensor,  # (1, N)
    width: int,
    height: int,
    tile_size: int,
    offsets: Tensor,
    order: Tensor,
    **named: object,
) -> tuple[Tensor, Tensor]:
    """(1, H, W, D) and (1, H, W, 1)."""
    y, x = torch.meshgrid(torch.arange(height) + 0.5, torch.arange(width) + 0.5, indexing="ij")
    dx, dy = (means2d[0, order, i, None, None] - at.to(means2d) for i, at in enumerate((x, y)))
    a, b, c = conics[0, order].T[:, :, None, None]
    sigma = 0.5 * (a * dx * dx + c * dy * dy) + b * dx * dy
    alpha = (opacities[0, order, None, None] * torch.exp(-sigma)).clamp(max=MAX_ALPHA)
    alpha = torch.where((sigma < 0) | (alpha < MIN_ALPHA), 0, alpha)
    alpha = torch.where(torch.cumprod(1 - alpha, dim=0) > MIN_TRANSMITTANCE, alpha, 0)
    left = torch.cat([alpha.new_ones(1, height, width), torch.cumprod(1 - alpha, dim=0)])
    return torch.einsum("nhw,nd->hwd", alpha * left[:-1], colors[0, order])[None], 1 - left[-1][None, :, :, None]
