"""Discontinuities of rendering, which comparisons of two correct rasterizers must exclude.

A Gaussian is culled or not (p(t) = 0.05, the near plane), a contribution is skipped or not (α' = 1/255), a pixel ends
or not (T = 1e-4), two Gaussians swap in depth. Near such a threshold two correct programs that round differently differ
by a whole contribution, and no finite difference converges. So tests drop the few Gaussians
(`away_from_discontinuities`) and mask the few pixels (`smooth_pixels`) near one, and compare all others tightly.

The kernel orders Gaussians by float32 depths, equal ones by row; beyond FAR_NEAR_PLANES near planes it orders them by
float64 depths, so that hardly any pair of depths is too close to tell apart.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from rasterizer.gaussians import Gaussians
from rasterizer.reference import render as reference
from rasterizer.reference.blend import MAX_ALPHA, MIN_ALPHA, MIN_TRANSMITTANCE, Splats, pixel_centers, squared_distance
from rasterizer.request import Request

FAR_NEAR_PLANES = 32_768  # as in the kernel (rasterizer/src/forward/depth_in_double.hpp)
SAME_DEPTH, SAME_FAR_DEPTH = 3e-6, 1e-12  # of the distance; rounding decides below (float32: 6e-8)


def away_from_discontinuities(gaussians: Gaussians, request: Request, margin: float = 1e-3) -> Gaussians:
    """The Gaussians that are not near a discontinuity or kink: p(t) = 0.05, z = near (for the flow at its later time
    too), a colour channel or the Jacobian at its clamp, the depth of another Gaussian.

    Exactly coincident means stay: both programs then compute equal depths and keep the order of the rows. Margins of
    lengths are relative to the distance from the camera, as rounding is; margins of slopes to fields of view below 1.
    """
    sliced = reference.slice_in_time(gaussians, request.time, request.marginal_offset)
    mean_cam = reference.world_to_camera(sliced.mean, request.camera)
    raised = gaussians.sh.clone()
    raised[:, 0] += 1e3  # lifts every colour above its clamp at zero; subtracted again below
    color = reference.colors(replace(gaussians, sh=raised), sliced, request) - 1e3 * 0.5 / np.sqrt(np.pi)
    z, camera, distance = mean_cam[:, 2], request.camera, mean_cam.norm(dim=1)
    close = (sliced.marginal - reference.MIN_MARGINAL).abs() < margin
    near_margin = margin * distance.clamp(max=1.0 if request.near == 0 else 5 * request.near)
    close |= (z - request.near).abs() < near_margin
    if "flow" in request.outputs:
        close |= (reference.later_position(sliced, request)[:, 2] - request.near).abs() < near_margin
    close |= (color.abs() < margin).any(dim=1)
    for slope, focal, low, size in (
        (mean_cam[:, 0] / z, camera.fx, camera.cx, camera.width),
        (mean_cam[:, 1] / z, camera.fy, camera.cy, camera.height),
    ):
        for edge in (-max(low, 0.0), max(size - low, 0.0)):
            close |= (slope - reference.FRUSTUM_MARGIN * edge / focal).abs() < margin * min(1.0, size / focal)
    order = torch.argsort(z, stable=True)
    behind, before = order[1:], order[:-1]
    far = z[before] > FAR_NEAR_PLANES * request.near * (1 + SAME_DEPTH)
    apart = torch.full_like(close, True)
    least = torch.where(far, SAME_FAR_DEPTH, SAME_DEPTH) * distance[behind].clamp(min=1e-30)
    apart[behind] = z[behind] - z[before] > least
    coincident = torch.zeros_like(close)
    coincident[behind] = (sliced.mean[behind] == sliced.mean[before]).all(dim=1)
    return gaussians.rows(torch.nonzero(~close & (apart | coincident)).squeeze(1))


@torch.no_grad()
def smooth_pixels(gaussians: Gaussians, request: Request, margin: float = 2e-3) -> Tensor:
    """(H, W) bool: True where no α' is near 1/255 or 0.99 and T is never near 1e-4.

    The relative margin is several times the rounding error of α' in float32; T accumulates such errors, so its margin
    is 10 times as large.
    """
    splats = reference.make_splats(gaussians, request)
    pixels = pixel_centers(request.camera, splats.center.dtype)
    return smooth_at(splats, pixels.reshape(-1, 2), margin).reshape(pixels.shape[:2])


@torch.no_grad()
def smooth_at(splats: Splats, pixels: Tensor, margin: float = 2e-3) -> Tensor:
    """The same, (P,), at the centres of pixels (P, 2)."""
    alpha = splats.opacity[:, None] * torch.exp(-0.5 * squared_distance(splats, pixels))
    near = ((alpha / MIN_ALPHA - 1).abs() < margin) | ((alpha - MAX_ALPHA).abs() < margin * 0.1)
    kept = torch.where(alpha < MIN_ALPHA, 0, alpha.clamp(max=MAX_ALPHA))
    near |= (torch.cumprod(1 - kept, dim=0) / MIN_TRANSMITTANCE - 1).abs() < 10 * margin
    return ~near.any(dim=0)
