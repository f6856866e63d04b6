"""Random Gaussians and small cameras for the rasterizer's tests, and helpers that render and differentiate them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from rasterizer.camera import Camera
from rasterizer.gaussians import Gaussians, Motion
from rasterizer.request import OUTPUT_CHANNELS, OUTPUT_NAMES, RenderOutput, Request
from rasterizer.trajectories import Trajectories

MOTIONS = ("full", "velocity", "shared", "separable", "static")


def outputs_of(motion: Motion) -> tuple[str, ...]:
    """All outputs of a kind of model; a static one has no temporal statistics."""
    return tuple(name for name in OUTPUT_NAMES if motion != "static" or name != "stats")


def generator(seed: int) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def uniform(shape: Sequence[int], low: float, high: float, rng: torch.Generator) -> Tensor:
    return low + (high - low) * torch.rand(shape, generator=rng, dtype=torch.float64)


def random_gaussians(
    n: int,
    motion: Motion | Literal["shared"],
    rng: torch.Generator,
    sh_degree: int = 3,
    fourier_order: int = 2,
    log_scale: tuple[float, float] = (-3.2, -1.5),
    opacity_logit: tuple[float, float] = (-2.0, 3.0),
) -> Gaussians:
    """n Gaussians in the cube [-1, 1]³ with μt in [-0.1, 1.1]: float64 tensors of float32 values.

    log_scale, opacity_logit: ranges. Quaternions are not normalised. In the full model qr is near the conjugate of ql,
    so that speeds are about 1, as those of the velocity model. The shared model has velocities and five trajectories. A
    static model has Fourier order 0 whatever `fourier_order` is.
    """
    fourier_order = 0 if motion == "static" else fourier_order
    normal = lambda *shape: torch.randn(shape, generator=rng, dtype=torch.float64)  # noqa: E731
    mean, scale = uniform((n, 3), -1, 1, rng), uniform((n, 3), *log_scale, rng)
    if motion != "static":
        mean = torch.cat([mean, uniform((n, 1), -0.1, 1.1, rng)], dim=1)
        scale = torch.cat([scale, uniform((n, 1), -2.0, -0.3, rng)], dim=1)
    left = normal(n, 4)
    right = None
    if motion == "full":
        right = left * torch.tensor([1, -1, -1, -1]) + 0.3 * normal(n, 4)
    sh = normal(n, fourier_order + 1, (sh_degree + 1) ** 2, 3) * 0.2
    sh[:, 0, 0] *= 4
    velocity = normal(n, 3) if motion in ("velocity", "shared") else None
    gaussians = Gaussians(mean, scale, left, right, uniform((n,), *opacity_logit, rng), sh.flatten(1, 2), velocity)
    if motion == "shared":
        trajectories = Trajectories(0.2 * normal(12, 5, 6), span=(-0.05, 0.85))
        gaussians = replace(gaussians, weights=0.7 * normal(n, 5), trajectories=trajectories)
    return gaussians.to(torch.float32).to(torch.float64)


def camera_looking_at(
    eye: Sequence[float],
    width: int = 45,
    height: int = 37,
    focal: float = 50.0,
    principal: tuple[float, float] | None = None,
    target: Sequence[float] = (0.0, 0.0, 0.0),
) -> Camera:
    """A camera at `eye` with `target` on its optical axis, its axes not aligned with the world's."""
    forward = np.subtract(target, eye)
    forward = forward / np.linalg.norm(forward)
    right = np.cross([0.1, 1.0, 0.2], forward)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = [right, np.cross(forward, right), forward]
    pose[:3, 3] = -pose[:3, :3] @ eye
    cx, cy = principal or (width / 2, height / 2)
    return Camera(width, height, focal, focal * 1.1, cx, cy, pose)


def off_centre_camera() -> Camera:
    """An image whose sides are no multiples of a tile (16) or block (4); the principal point is off its centre."""
    return camera_looking_at((0.6, -0.8, -3.0), principal=(19.3, 21.7))


def make_request(**changes) -> Request:
    """One view by `off_centre_camera`, over a coloured background; `changes` as Request's fields."""
    return replace(Request(off_centre_camera(), time=0.45, duration=0.8, background=(0.3, 0.6, 0.1)), **changes)


def output_weights(request: Request, mask: Tensor, rng: torch.Generator) -> dict[str, Tensor]:
    """A random ∂L/∂image of each requested output, zero where `mask` (H, W) is False."""
    size = (request.camera.height, request.camera.width)
    return {
        name: torch.randn((OUTPUT_CHANNELS[name], *size), generator=rng, dtype=torch.float64) * mask
        for name in request.outputs
    }


def render(rasterize: Callable[..., RenderOutput], gaussians: Gaussians, request: Request) -> RenderOutput:
    """Call a `rasterize` function with the fields of a Request."""
    return rasterize(gaussians, **{name: getattr(request, name) for name in request.__dataclass_fields__})


def render_and_gradients(
    rasterize: Callable[..., RenderOutput], gaussians: Gaussians, request: Request, weights: dict[str, Tensor]
) -> tuple[RenderOutput, dict[str, Tensor]]:
    """The images, and ∂L/∂parameter by name, for L = Σ weights · images."""
    leaves = {name: tensor.detach().clone().requires_grad_() for name, tensor in gaussians.tensors().items()}
    out = render(rasterize, Gaussians.from_tensors(leaves, gaussians.span), request)
    loss = sum((getattr(out, name) * weight.to(gaussians.mean.dtype)).sum() for name, weight in weights.items())
    found = torch.autograd.grad(loss, list(leaves.values()), allow_unused=True)
    return out, {
        name: torch.zeros_like(leaf) if gradient is None else gradient
        for (name, leaf), gradient in zip(leaves.items(), found)
    }


def quaternion_product(a: Tensor, b: Tensor) -> Tensor:
    """The Hamilton product a b of quaternions (…, 4) in the order w, x, y, z."""
    (aw, ax, ay, az), (bw, bx, by, bz) = a.unbind(-1), b.unbind(-1)  # broadcast
    return torch.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        dim=-1,
    )


def conjugate(q: Tensor) -> Tensor:
    return q * torch.tensor([1, -1, -1, -1], dtype=q.dtype)


def rotated_world(gaussians: Gaussians, camera: Camera, left: Tensor) -> tuple[Gaussians, Camera]:
    """The Gaussians and the camera rotated together about the origin, by the rotation of quaternion `left` (4,).

    v -> l v r with v = x + yi + zj + tk rotates space and keeps time when l k r = k, that is r = -k l* k.
    SH coefficients are not rotated, so colours must not depend on the direction (SH degree 0).
    """
    left = left / left.norm()
    k = torch.tensor([0.0, 0, 0, 1], dtype=left.dtype)
    right = -quaternion_product(quaternion_product(k, conjugate(left)), k)
    axes = torch.eye(4, dtype=left.dtype)
    rotation = quaternion_product(quaternion_product(left, axes), right).T  # column i is the image of axis i
    mean = gaussians.mean.clone()
    mean[:, :3] = mean[:, :3] @ rotation[:3, :3].T.to(mean.dtype)
    if gaussians.motion == "full":
        quat_left = quaternion_product(left.to(mean.dtype), gaussians.quat_left)
        quat_right = quaternion_product(gaussians.quat_right, right.to(mean.dtype))
    else:
        x, y, z, w = Rotation.from_matrix(rotation[:3, :3].numpy()).as_quat()
        quat_left = quaternion_product(torch.tensor([w, x, y, z], dtype=mean.dtype), gaussians.quat_left)
        quat_right = None
    velocity = None if gaussians.velocity is None else gaussians.velocity @ rotation[:3, :3].T.to(mean.dtype)
    rotated = replace(gaussians, mean=mean, quat_left=quat_left, quat_right=quat_right, velocity=velocity)
    if gaussians.trajectories is not None:
        points = gaussians.trajectories.control_points.unflatten(2, (2, 3)) @ rotation[:3, :3].T.to(mean.dtype)
        rotated = replace(rotated, trajectories=Trajectories(points.flatten(2), gaussians.span))
    return rotated, replace(camera, world_to_cam=camera.world_to_cam @ rotation.T.numpy())
