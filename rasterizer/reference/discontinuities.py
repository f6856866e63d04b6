"""Where rendering is not continuous: what to leave out when two correct rasterizers are compared.

Rendering has jumps: a Gaussian takes part or not (p(t) = 0.05, the near plane), a contribution is skipped
or not (α' = 1/255), a pixel ends or not (T = 1e-4), two Gaussians swap in depth. Next to one, two correct
programs that round differently differ by a whole contribution, and no finite difference converges. So tests
drop the few Gaussians (`away_from_jumps`) and mask the few pixels (`smooth_pixels`) that lie next to one,
and compare all the others tightly.

Up to FAR_NEAR_PLANES near planes away the kernel orders Gaussians by their depths in float32, equal ones by their
rows; beyond, by their depths in double, and next to no depth is a jump.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from rasterizer.arguments import Request
from rasterizer.gaussians import Gaussians
from rasterizer.reference import render as reference
from rasterizer.reference.blend import MAX_ALPHA, MIN_ALPHA, MIN_TRANSMITTANCE, pixel_centers, squared_distance

FAR_NEAR_PLANES = 32_768  # the kernel's (rasterizer/src/forward/depth_in_double.hpp)
SAME_DEPTH, SAME_FAR_DEPTH = 3e-6, 1e-12  # of the distance: below it rounding decides; float32 rounds to 6e-8


def rows(gaussians: Gaussians, index: Tensor) -> Gaussians:
    return Gaussians(**{"quat_right": None, **{name: t[index] for name, t in gaussians.tensors().items()}})


def away_from_discontinuities(gaussians: Gaussians, request: Request, margin: float = 1e-3) -> Gaussians:
    """Without the rows next to a jump or kink that a whole Gaussian has: p(t) = 0.05, z = near, a colour
    channel or the Jacobian at the edge of its clamp, a depth shared with another.

    Exactly coincident ones stay: both programs then see equal depths and take the order of the rows. Margins of
    lengths are relative to the distance from the camera, as rounding is; those of slopes to a field of view below 1.
    """
    sliced = reference.slice_in_time(gaussians, request.time)
    mean_cam = reference.world_to_camera(sliced.mean, request.camera)
    raised = gaussians.sh.clone()
    raised[:, 0] += 1e3  # lifts every colour off its clamp at zero
    lift = 1e3 * 0.5 / np.sqrt(np.pi)
    color = reference.colors(replace(gaussians, sh=raised), sliced, request) - lift
    z, camera, distance = mean_cam[:, 2], request.camera, mean_cam.norm(dim=1)
    close = (sliced.marginal - reference.MIN_MARGINAL).abs() < margin
    close |= (z - request.near).abs() < margin * distance.clamp(max=1.0 if request.near == 0 else 5 * request.near)
    close |= (color.abs() < margin).any(dim=1)
    for slope, focal, low, size in (
        (mean_cam[:, 0] / z, camera.fx, camera.cx, camera.width),
        (mean_cam[:, 1] / z, camera.fy, camera.cy, camera.height),
    ):
        for edge in (-low, size - low):
            close |= (slope - reference.FRUSTUM_MARGIN * edge / focal).abs() < margin * min(1.0, size / focal)
    order = torch.argsort(z, stable=True)
    behind, before = order[1:], order[:-1]
    far = z[before] > FAR_NEAR_PLANES * request.near * (1 + SAME_DEPTH)
    apart = torch.full_like(close, True)
    least = torch.where(far, SAME_FAR_DEPTH, SAME_DEPTH) * distance[behind].clamp(min=1e-30)
    apart[behind] = z[behind] - z[before] > least
    coincident = torch.zeros_like(close)
    coincident[behind] = (sliced.mean[behind] == sliced.mean[before]).all(dim=1)
    return rows(gaussians, torch.nonzero(~close & (apart | coincident)).squeeze(1))


@torch.no_grad()
def smooth_pixels(gaussians: Gaussians, request: Request, margin: float = 2e-3) -> Tensor:
    """(H, W) True where no α' is next to 1/255 or 0.99 and T never next to 1e-4.

    The margin, relative, is some times what float32 loses in α'; T accumulates such errors, so it has 10
    times that.
    """
    splats = reference.make_splats(gaussians, request)
    pixels = pixel_centers(request.camera, splats.center.dtype).reshape(-1, 2)
    alpha = splats.opacity[:, None] * torch.exp(-0.5 * squared_distance(splats, pixels))
    next_to = ((alpha / MIN_ALPHA - 1).abs() < margin) | ((alpha - MAX_ALPHA).abs() < margin * 0.1)
    kept = torch.where(alpha < MIN_ALPHA, 0, alpha.clamp(max=MAX_ALPHA))
    next_to |= (torch.cumprod(1 - kept, dim=0) / MIN_TRANSMITTANCE - 1).abs() < 10 * margin
    return ~next_to.any(dim=0).reshape(request.camera.height, request.camera.width)
