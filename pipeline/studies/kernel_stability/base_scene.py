"""The base scene that every case modifies, and the rotations that give Gaussians a velocity."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from rasterizer import Camera, Gaussians, Request

OUTPUTS = ("color", "alpha", "depth", "flow", "stats")
DISTANCE = 3.0  # from the camera to the middle of the scene, world units


def generator(seed: int) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def uniform(shape: Sequence[int], low: float, high: float, rng: torch.Generator) -> Tensor:
    return low + (high - low) * torch.rand(shape, generator=rng, dtype=torch.float64)


def camera_at(
    distance: float,
    width: int = 32,
    height: int = 24,
    focal: float = 30.0,
    target: Sequence[float] | np.ndarray = (0.0, 0.0, 0.0),
) -> Camera:
    """A camera at `distance` from `target` that faces it, with no axis parallel to the world's; focal in pixels."""
    away = np.array([0.2, -0.35, -1.0])
    forward = -away / np.linalg.norm(away)
    right = np.cross([0.1, 1.0, 0.2], forward)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = [right, np.cross(forward, right), forward]
    pose[:3, 3] = -pose[:3, :3] @ (np.asarray(target) - distance * forward)
    return Camera(width, height, focal, focal * 1.1, 0.48 * width, 0.53 * height, pose)


def base_gaussians(count: int, seed: int, sh_degree: int = 3, fourier_order: int = 2) -> Gaussians:
    """Slow Gaussians of scale 0.05 to 0.25 in the cube [-0.8, 0.8]³, at times about [0, 1]; float64."""
    rng = generator(seed)
    normal = lambda *shape: torch.randn(shape, generator=rng, dtype=torch.float64)  # noqa: E731
    mean = torch.cat([uniform((count, 3), -0.8, 0.8, rng), uniform((count, 1), 0.2, 0.8, rng)], dim=1)
    scale = torch.cat([uniform((count, 3), -3.0, -1.4, rng), uniform((count, 1), -1.5, -0.5, rng)], dim=1)
    left = normal(count, 4)
    right = left * torch.tensor([1, -1, -1, -1]) + 0.2 * normal(count, 4)
    sh = 0.15 * normal(count, fourier_order + 1, (sh_degree + 1) ** 2, 3)
    sh[:, 0, 0] = normal(count, 3).abs()
    return Gaussians(mean, scale, left, right, uniform((count,), -1.5, 2.0, rng), sh.flatten(1, 2))


def base_request(**changes) -> Request:
    """All outputs at the middle of a duration of 1; flow over 0.01."""
    request = Request(camera_at(DISTANCE), time=0.5, background=(0.2, 0.4, 0.1), outputs=OUTPUTS, flow_dt=0.01)
    return replace(request, **changes)


def quaternion_product(a: Tensor, b: Tensor) -> Tensor:
    """Hamilton's a b of quaternions (…, 4), w first."""
    (aw, ax, ay, az), (bw, bx, by, bz) = a.unbind(-1), b.unbind(-1)
    return torch.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        dim=-1,
    )


def moving_quaternions(speed: Tensor, space: Tensor) -> tuple[Tensor, Tensor]:
    """(ql, qr), (N, 4) each: a rotation from x towards t by θ = atan(1/speed), then a rotation of space by `space`.

    A Gaussian that is long in x and short in time then moves at about `speed` (N,). The rotation v → l v r of
    v = x + yi + zj + tk keeps the time axis when l k r = k, that is r = -k l* k.
    """
    half = 0.5 * torch.atan2(torch.ones_like(speed), speed)
    zero = torch.zeros_like(half)
    tilt = torch.stack([half.cos(), zero, zero, half.sin()], dim=-1)
    left = space / space.norm(dim=-1, keepdim=True)
    k = left.new_tensor([0, 0, 0, 1])
    right = -quaternion_product(quaternion_product(k, left * left.new_tensor([1, -1, -1, -1])), k)
    return quaternion_product(left, tilt), quaternion_product(tilt, right)


def with_log_scale(gaussians: Gaussians, *scales: float | None) -> Gaussians:
    """The Gaussians with these standard deviations (x, y, z in world units, then time); None keeps one."""
    log_scale = gaussians.log_scale.clone()
    for axis, scale in enumerate(scales):
        if scale is not None:
            log_scale[:, axis] = math.log(scale)
    return replace(gaussians, log_scale=log_scale)


def with_mean(gaussians: Gaussians, space: Tensor | None = None, time: Tensor | None = None) -> Gaussians:
    """The Gaussians at positions `space` (N, 3), world units, and times `time` (N,); None keeps them."""
    mean = gaussians.mean.clone()
    if space is not None:
        mean[:, :3] = space
    if time is not None:
        mean[:, 3] = time
    return replace(gaussians, mean=mean)
