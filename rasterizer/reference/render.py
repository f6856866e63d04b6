"""Reference implementation of the 4D Gaussian rasterizer in plain PyTorch: slice in time, project, colour, blend.

One function per equation of the method, in any floating-point type, differentiable by autograd. The kernel is tested
against it. Every pixel evaluates every Gaussian in view, so it is for small scenes only.

Notation: N Gaussians, V of them in view; μ mean, s scale, R rotation, M = R diag(s), Σ = M Mᵀ, t time.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor

from rasterizer.camera import Camera
from rasterizer.covariance import scaled_axes
from rasterizer.gaussians import Gaussians
from rasterizer.reference.blend import MIN_MARGINAL, Splats, blend
from rasterizer.reference.sh import sh_color
from rasterizer.request import OUTPUT_CHANNELS, RenderOutput, Request
from rasterizer.validation import as_float, check_finite

FRUSTUM_MARGIN = 1.3  # the linearised perspective degenerates far outside the image (3DGS)
DILATION = 0.3  # px², added to Σ2d: no splat is so thin that it falls between pixel centres (3DGS)
MAX_LOGIT = 80.0  # float32 represents e^80 = 5e34 and its inverse
FEATURES = ("color", "depth", "flow", "stats")  # outputs that are sums Σ w · feature


# ---- Slicing in time ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Slice:
    """The 4D Gaussians conditioned on a time: 3D Gaussians with covariance A Aᵀ, and their temporal marginal p(t)."""

    mean: Tensor  # (N, 3) μ(t), world
    factor: Tensor  # (N, 3, 4) A, or (N, 3, 3) for a static model
    marginal: Tensor  # (N,) temporal marginal p(t) in [0, 1]
    velocity: Tensor  # (N, 3) dμ(t)/dt, world units per unit of time
    variance_t: Tensor | None  # (N,) Σtt; None for a static model


def slice_in_time(gaussians: Gaussians, time: float, marginal_offset: float = 0.0, flow_dt: float = 0.0) -> Slice:
    """Condition the 4D Gaussians on the time (docs/method.md 1.1).

    p(t) = exp(-½ (t-μt)²/Σtt) and μ(t) = μ_xyz + Σ_xyz,t Σtt⁻¹ (t-μt). The textbook form of the conditional
    covariance, Σ_xyz - Σ_xyz,t Σtt⁻¹ Σ_t,xyz, cancels catastrophically for fast motion. With m_t the time row of M and
    v = m_t/|m_t| it equals A Aᵀ with A = M_xyz (I - v vᵀ), which is positive semi-definite by construction.
    marginal_offset: p alone is that of time + this (docs/method.md 5.2). flow_dt: the velocity along trajectories is
    the mean one until time + this.
    """
    gaussians, drift = moved(gaussians, time, flow_dt)
    axes = scaled_axes(gaussians)
    if gaussians.motion == "static":
        ones = torch.ones_like(gaussians.opacity_logit)
        return Slice(gaussians.mean, axes, ones, torch.zeros_like(gaussians.mean), None)
    space, time_row = axes[:, :3], axes[:, 3]
    sigma_t = time_row.norm(dim=-1)  # √Σtt = |m_t|
    v = time_row / sigma_t[:, None]
    along_v = torch.einsum("nij,nj->ni", space, v)  # M_xyz v = Σ_xyz,t / |m_t|
    velocity = along_v / sigma_t[:, None]
    elapsed = time - gaussians.mean[:, 3]
    return Slice(
        mean=gaussians.mean[:, :3] + velocity * elapsed[:, None],
        factor=space - along_v[:, :, None] * v[:, None, :],
        marginal=torch.exp(-0.5 * ((elapsed + marginal_offset) / sigma_t) ** 2),
        velocity=velocity + drift,
        variance_t=sigma_t**2,
    )


def moved(gaussians: Gaussians, time: float, flow_dt: float = 0.0) -> tuple[Gaussians, Tensor]:
    """The Gaussians displaced and turned along the shared trajectories, and how fast these move them, (N, 3)."""
    if gaussians.trajectories is None or gaussians.weights is None:
        return gaussians, torch.zeros_like(gaussians.mean[:, :3])
    displacement, turn = (gaussians.weights @ gaussians.trajectories.values(time)).split(3, dim=1)
    place = replace(
        gaussians,
        mean=gaussians.mean + F.pad(displacement, (0, 1)),
        quat_left=quaternion_product(turning(turn), gaussians.quat_left),
        weights=None,
        trajectories=None,
    )
    return place, gaussians.weights @ gaussians.trajectories.drift(time, flow_dt)


def turning(turn: Tensor) -> Tensor:
    """Unit quaternions (N, 4), w first, that turn by the angle |r| about r (N, 3): (cos(|r|/2), sin(|r|/2)/|r| r)."""
    half = 0.5 * (turn * turn).sum(dim=1, keepdim=True).clamp_min(1e-24).sqrt()  # clamped: its root has a gradient
    return torch.cat([half.cos(), 0.5 * (half.sin() / half) * turn], dim=1)


def quaternion_product(a: Tensor, b: Tensor) -> Tensor:
    """Hamilton products (N, 4) of quaternions, w first."""
    aw, ax, ay, az = a.unbind(-1)
    bw, bx, by, bz = b.unbind(-1)
    return torch.stack([
        aw * bw - ax * bx - ay * by - az * bz, aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx, aw * bz + ax * by - ay * bx + az * bw,
    ], dim=-1)  # fmt: skip


# ---- Projection --------------------------------------------------------------------------------------------


def world_to_camera(points: Tensor, camera: Camera) -> Tensor:
    """World points (N, 3) in camera coordinates: x right, y down, z forward."""
    pose = torch.tensor(camera.world_to_cam, dtype=points.dtype, device=points.device)
    return points @ pose[:3, :3].T + pose[:3, 3]


def project_point(point_cam: Tensor, camera: Camera) -> Tensor:
    """Pixel positions (N, 2) of points in camera coordinates (N, 3): (fx x/z + cx, fy y/z + cy)."""
    x, y, z = point_cam.unbind(-1)
    return torch.stack([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy], dim=-1)


def project_factor(factor: Tensor, mean_cam: Tensor, camera: Camera) -> Tensor:
    """B = J W A (N, 2, 3 or 4), so that B Bᵀ is the projected covariance in px² (EWA splatting, docs/method.md 1.2).

    W is the camera's rotation and J the Jacobian of the perspective at the mean. In J only, x/z and y/z are clamped
    to 1.3 × the half field of view on each side of the principal point, to 0 on a side without any image.
    """
    x, y, z = mean_cam.unbind(-1)
    u = (x / z).clamp(*_frustum_limits(camera.cx, camera.width, camera.fx))
    v = (y / z).clamp(*_frustum_limits(camera.cy, camera.height, camera.fy))
    zero = torch.zeros_like(z)
    jacobian = torch.stack(
        [camera.fx / z, zero, -camera.fx * u / z, zero, camera.fy / z, -camera.fy * v / z], dim=-1
    ).reshape(-1, 2, 3)
    rotation = torch.tensor(camera.world_to_cam[:3, :3], dtype=factor.dtype, device=factor.device)
    return jacobian @ (rotation @ factor)


def _frustum_limits(principal: float, size: int, focal: float) -> tuple[float, float]:
    return -FRUSTUM_MARGIN * max(principal, 0.0) / focal, FRUSTUM_MARGIN * max(size - principal, 0.0) / focal


def ellipse(projected_factor: Tensor) -> Tensor:
    """(k, V, C) (N, 3) of the dilated 2D covariance Σ2d = B Bᵀ + 0.3 I, from B (N, 2, K), such that

        dᵀ Σ2d⁻¹ d = (dx + k dy)²/V + dy²/C,   C = cyy,   k = -cxy/C,   V = det Σ2d / C.

    In this form no digits cancel. With Σ2d⁻¹ itself a needle as long as the scene loses all of them, its gradient even
    in float64. det(B Bᵀ) is a sum of squares (Cauchy-Binet), Σ_i<j (B_0i B_1j - B_0j B_1i)², since cxx cyy - cxy²
    cancels for long streaks.
    """
    row0, row1 = projected_factor.unbind(1)
    first, second = torch.combinations(torch.arange(row0.shape[1])).unbind(1)  # column pairs i < j
    minors = row0[:, first] * row1[:, second] - row0[:, second] * row1[:, first]
    norm_x, norm_y = (row0 * row0).sum(1), (row1 * row1).sum(1)
    variance_y = norm_y + DILATION  # C
    shear = -(row0 * row1).sum(1) / variance_y  # k
    # V = det/C, each term divided before the sum: det itself may overflow
    variance_x = ((minors / variance_y.sqrt()[:, None]) ** 2).sum(1) + DILATION * (norm_x + variance_y) / variance_y
    return torch.stack([shear, variance_x, variance_y], dim=-1)


# ---- Rendering ---------------------------------------------------------------------------------------------


@torch.no_grad()
def blending_order(gaussians: Gaussians, request: Request, min_marginal: float = MIN_MARGINAL) -> Tensor:
    """Rows (V,) of the Gaussians with p(t) >= min_marginal and depth z > near, nearest first; equal depths by row."""
    sliced = slice_in_time(gaussians, request.time, request.marginal_offset)
    depth = world_to_camera(sliced.mean, request.camera)[:, 2]
    in_view = torch.nonzero((sliced.marginal >= min_marginal) & (depth > request.near)).squeeze(1)
    return in_view[torch.argsort(depth[in_view], stable=True)]


def viewing_direction(sliced: Slice, camera: Camera) -> Tensor:
    """(N, 3) unit, from the camera to the slices."""
    position = torch.tensor(camera.position, dtype=sliced.mean.dtype, device=sliced.mean.device)
    return F.normalize(sliced.mean - position, dim=-1)


def colors(gaussians: Gaussians, sliced: Slice, request: Request) -> Tensor:
    """RGB (N, 3) of the slices from the camera's position, with coefficients up to the requested degree and order."""
    order = gaussians.fourier_order if request.fourier_order is None else request.fourier_order
    degree = gaussians.sh_degree if request.sh_degree is None else request.sh_degree
    stored = gaussians.sh.unflatten(1, (gaussians.fourier_order + 1, (gaussians.sh_degree + 1) ** 2))
    direction = viewing_direction(sliced, request.camera)
    elapsed = None if gaussians.motion == "static" else request.time - gaussians.mean[:, 3]
    used = stored[:, : order + 1, : (degree + 1) ** 2]
    released = request.released_gradients
    if "detached" in released:
        direction, elapsed = direction.detach(), None if elapsed is None else elapsed.detach()
    if "untrained" in released:
        used = torch.cat([used[:, :1], used[:, 1:].detach()], dim=1)
    return sh_color(used, direction, elapsed, request.duration, wrong_line="wrong_line" in released)


def displacement(sliced: Slice, request: Request) -> Tensor:
    """Optical flow proj'(μ(t+δ)) - proj(μ(t)), (N, 2) pixels, proj' by the camera at that time; zero where μ(t+δ) lies
    before its near plane."""
    camera, later_camera = request.camera, request.flow_camera or request.camera
    now, later = world_to_camera(sliced.mean, camera), later_position(sliced, request)
    in_front = later[:, 2:] > request.near
    flow = project_point(torch.where(in_front, later, 1.0), later_camera) - project_point(now, camera)
    return torch.where(in_front, flow, 0.0)


def later_position(sliced: Slice, request: Request) -> Tensor:
    """μ(t+δ) in the camera at that time, (N, 3)."""
    mean = sliced.mean + sliced.velocity * as_float(request.flow_dt)
    return world_to_camera(mean, request.flow_camera or request.camera)


def opacity(logit: Tensor) -> Tensor:
    """sigmoid(logit), (N,); constant beyond ±80, where its gradient is too small for float32.

    The gradient of torch.sigmoid, σ (1 - σ), is zero from 37 on, where 1 - σ rounds to zero in float64.
    """
    return F.logsigmoid(logit.clamp(-MAX_LOGIT, MAX_LOGIT)).exp()


def features(gaussians: Gaussians, sliced: Slice, request: Request) -> Tensor:
    """(N, C) what the requested outputs blend, in the order of FEATURES."""
    found = [sliced.mean[:, :0]]  # no channels: torch.cat needs a tensor even if only alpha is requested
    if "color" in request.outputs:
        found.append(colors(gaussians, sliced, request))
    if "depth" in request.outputs:
        found.append(world_to_camera(sliced.mean, request.camera)[:, 2:])
    if "flow" in request.outputs:
        found.append(displacement(sliced, request))
    if "stats" in request.outputs and sliced.variance_t is not None:
        found.append(torch.stack([gaussians.mean[:, 3], sliced.variance_t], dim=-1))
    return torch.cat(found, dim=-1)


def named_images(sums: Tensor, transmittance: Tensor, request: Request) -> dict[str, Tensor]:
    """The requested outputs from the blended `features` (C, H, W) and the final transmittance (H, W)."""
    named = [name for name in FEATURES if name in request.outputs]
    images = dict(zip(named, sums.split([OUTPUT_CHANNELS[name] for name in named])))
    if "color" in request.outputs:
        behind = torch.tensor(request.background, dtype=sums.dtype, device=sums.device)
        images["color"] = images["color"] + transmittance * behind[:, None, None]
    if "alpha" in request.outputs:
        images["alpha"] = 1 - transmittance[None]
    return images


def slice_of(gaussians: Gaussians, request: Request) -> Slice:
    """The Gaussians at the time of the view."""
    flow_dt = as_float(request.flow_dt) if "flow" in request.outputs else 0.0
    return slice_in_time(gaussians, request.time, request.marginal_offset, flow_dt)


def make_splats(gaussians: Gaussians, request: Request, min_marginal: float = MIN_MARGINAL) -> Splats:
    """Slice, project and colour the Gaussians in view."""
    index = blending_order(gaussians, request, min_marginal)
    gaussians = gaussians.rows(index)
    sliced = slice_of(gaussians, request)
    mean_cam = world_to_camera(sliced.mean, request.camera)
    return Splats(
        index=index,
        center=project_point(mean_cam, request.camera),
        ellipse=ellipse(project_factor(sliced.factor, mean_cam, request.camera)),
        opacity=opacity(gaussians.opacity_logit) * sliced.marginal,
        features=features(gaussians, sliced, request),
    )


def rasterize(gaussians: Gaussians, *view: Any, **named_view: Any) -> RenderOutput:
    """Render the Gaussians; `view` and `named_view` are the fields of `rasterizer.Request`, the camera first.

    Raises ValueError for a parameter or argument that is not finite, out of range or missing.
    """
    request = Request(*view, **named_view)
    request.check_against(gaussians)
    check_finite(gaussians)
    sums, transmittance = blend(make_splats(gaussians, request), request.camera)
    return RenderOutput(**{"color": None, **named_images(sums, transmittance, request)})
