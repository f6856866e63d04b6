"""gsplat on the CPU: its `rasterization` with the CUDA functions replaced by their PyTorch twins.

Projection, tiles and offsets are gsplat's own twins (gsplat/cuda/_torch_impl.py). That of its blending needs CUDA
itself; `blend_tiles` is the loop of gsplat's RasterizeToPixels3DGSFwd.cu over tiles, pixels side by side. `culled` is
what its ProjectionEWA3DGSFused.cu culls and the twin does not.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from unittest.mock import patch

import torch
from torch import Tensor

MAX_ALPHA, MIN_ALPHA, MIN_TRANSMITTANCE = 0.999, 1 / 255, 1e-4  # of gsplat's RasterizeToPixels3DGSFwd.cu
UNDEFINED = -12345.0  # CUDA leaves what it culls as it was in memory


@contextmanager
def gsplat_on_the_cpu() -> Iterator[None]:
    """Within it gsplat.rasterization runs on the CPU, differentiable by autograd, in any floating-point type."""
    import gsplat.rendering
    from gsplat.cuda import _torch_impl as twins

    def project(means, covars, quats, scales, viewmats, intrinsics, width, height, *, opacities, near_plane, **named):
        assert quats is None and scales is None and not named.pop("packed") and not named.pop("sparse_grad")
        assert named.pop("radius_clip") == 0.0
        full = covars[..., [0, 1, 2, 1, 3, 4, 2, 4, 5]].unflatten(-1, (3, 3))
        found = twins._fully_fused_projection(
            means, full, viewmats, intrinsics, width, height, near_plane=near_plane, **named
        )
        radii, means2d, depths, conics, compensations = found
        radii[:, opacities < MIN_ALPHA] = 0
        seen = (radii > 0).all(dim=-1, keepdim=True)
        means2d, conics = torch.where(seen, means2d, UNDEFINED), torch.where(seen, conics, UNDEFINED)
        return radii, means2d, torch.where(seen[..., 0], depths, UNDEFINED), conics, compensations

    def tiles(means2d, radii, depths, size, width, height, **named):
        at = means2d.detach().float().cpu(), radii.cpu(), depths.detach().float().cpu()  # it sorts the bits of floats
        return tuple(tensor.to(means2d.device) for tensor in twins._isect_tiles(*at, size, width, height))

    with (
        patch.object(gsplat.rendering, "fully_fused_projection", project),
        patch.object(gsplat.rendering, "isect_tiles", tiles),
        patch.object(gsplat.rendering, "isect_offset_encode", twins._isect_offset_encode),
        patch.object(gsplat.rendering, "rasterize_to_pixels", blend_tiles),
    ):
        yield


def blend_tiles(
    means2d: Tensor,  # (1, N, 2)
    conics: Tensor,  # (1, N, 3)
    colors: Tensor,  # (1, N, D)
    opacities: Tensor,  # (1, N)
    width: int,
    height: int,
    tile_size: int,
    offsets: Tensor,  # (1, rows, columns)
    flatten_ids: Tensor,
    **named: object,
) -> tuple[Tensor, Tensor]:
    """(1, H, W, D) and (1, H, W, 1)."""
    ends = [*offsets.flatten().cpu().tolist(), len(flatten_ids)]
    rows = []
    for row in range(offsets.shape[1]):
        columns = []
        for column in range(offsets.shape[2]):
            tile = row * offsets.shape[2] + column
            ids = flatten_ids[ends[tile] : ends[tile + 1]].long()
            y, x = torch.meshgrid(
                torch.arange(row * tile_size, min((row + 1) * tile_size, height)),
                torch.arange(column * tile_size, min((column + 1) * tile_size, width)),
                indexing="ij",
            )
            dx, dy = (means2d[0, ids, i, None, None] - (at + 0.5).to(means2d.device) for i, at in enumerate((x, y)))
            a, b, c = conics[0, ids].T[:, :, None, None]
            sigma = 0.5 * (a * dx * dx + c * dy * dy) + b * dx * dy
            alpha = (opacities[0, ids, None, None] * torch.exp(-sigma)).clamp(max=MAX_ALPHA)
            alpha = torch.where((sigma < 0) | (alpha < MIN_ALPHA), 0, alpha)
            after = torch.cumprod(1 - alpha, dim=0)
            alpha = torch.where(after > MIN_TRANSMITTANCE, alpha, 0)
            before = torch.cat([alpha.new_ones(1, *alpha.shape[1:]), torch.cumprod(1 - alpha, dim=0)])
            weight = alpha * before[:-1]
            columns.append(
                torch.cat([torch.einsum("nhw,nd->hwd", weight, colors[0, ids]), 1 - before[-1][..., None]], -1)
            )
        rows.append(torch.cat(columns, dim=1))
    image = torch.cat(rows)[None]
    return image[..., :-1], image[..., -1:]
