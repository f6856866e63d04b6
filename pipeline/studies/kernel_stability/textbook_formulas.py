"""The textbook formulas, which subtract nearly equal numbers, in place of the reference implementation's stable ones.

    Σ(t) = Σ_xyz - Σ_xyz,t Σtt⁻¹ Σ_t,xyz,     det Σ2d = cxx cyy - cxy²

Both suffer from cancellation in float32. Colours and blending are the reference implementation's.
"""

from __future__ import annotations

import torch
from torch import Tensor

from rasterizer import Gaussians, RenderOutput, Request
from rasterizer.reference import render as reference
from rasterizer.reference.blend import Splats, blend

OUTPUTS = ("color", "alpha", "depth")


def covariance(gaussians: Gaussians) -> Tensor:
    """Σ(t) (N, 3, 3) = Σ_xyz - Σ_xyz,t Σtt⁻¹ Σ_t,xyz."""
    axes = reference.scaled_axes(gaussians)
    sigma = axes @ axes.mT
    if gaussians.motion == "static":
        return sigma
    across = sigma[:, :3, 3]
    return sigma[:, :3, :3] - across[:, :, None] * across[:, None, :] / sigma[:, 3, 3, None, None]


def covariance_2d(gaussians: Gaussians, mean_cam: Tensor, request: Request) -> Tensor:
    """J W Σ(t) Wᵀ Jᵀ + 0.3 I (N, 2, 2), px²."""
    identity = torch.eye(3, dtype=mean_cam.dtype).expand(len(mean_cam), 3, 3)
    projection = reference.project_factor(identity, mean_cam, request.camera)
    spread = projection @ covariance(gaussians) @ projection.mT
    return spread + reference.DILATION * torch.eye(2, dtype=spread.dtype)


def ellipse(covariance: Tensor) -> Tensor:
    """(k, V, C) (N, 3) as `reference.ellipse`, with the determinant xx yy - xy²."""
    xx, xy, yy = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
    return torch.stack([-xy / yy, (xx * yy - xy * xy) / yy, yy], dim=-1)


def indefinite(gaussians: Gaussians, request: Request) -> int:
    """Number of Gaussians in view whose computed 2D covariance, with dilation, is not positive definite."""
    with torch.no_grad():
        index = reference.blending_order(gaussians, request)
        gaussians, _ = reference.moved(gaussians.rows(index), request.time)
        mean = reference.slice_in_time(gaussians, request.time).mean
        sigma = covariance_2d(gaussians, reference.world_to_camera(mean, request.camera), request)
        xx, xy, yy = sigma[:, 0, 0], sigma[:, 0, 1], sigma[:, 1, 1]
        return int((~((xx > 0) & (yy > 0) & (xx * yy - xy * xy > 0))).sum())


def rasterize(gaussians: Gaussians, **arguments) -> RenderOutput:
    """As `reference.rasterize`, for OUTPUTS only."""
    request = Request(**arguments)
    index = reference.blending_order(gaussians, request)
    gaussians, _ = reference.moved(gaussians.rows(index), request.time)
    sliced = reference.slice_in_time(gaussians, request.time)
    mean_cam = reference.world_to_camera(sliced.mean, request.camera)
    features = torch.cat([reference.colors(gaussians, sliced, request), mean_cam[:, 2:]], dim=1)
    splats = Splats(
        index,
        reference.project_point(mean_cam, request.camera),
        ellipse(covariance_2d(gaussians, mean_cam, request)),
        reference.opacity(gaussians.opacity_logit) * sliced.marginal,
        features,
    )
    sums, transmittance = blend(splats, request.camera)
    behind = torch.tensor(request.background, dtype=sums.dtype)
    return RenderOutput(sums[:3] + transmittance * behind[:, None, None], 1 - transmittance[None], sums[3:])
