"""4D rotations and the factor M of the covariance Σ = M Mᵀ, in PyTorch: any floating-point type, differentiable."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from rasterizer.gaussians import Gaussians

MAX_INVERSE_NORM = 1e30  # of a quaternion, in gradients


def normalise_quaternion(quat: Tensor) -> Tensor:
    """Unit quaternions (N, 4); a zero quaternion becomes the identity (1, 0, 0, 0) and gets no gradient.

    Dividing by the largest component first keeps the squares from under- or overflowing. The result does not depend on
    that divisor, so it is treated as a constant. The gradient is proportional to 1/|q|, which is limited to 1e30:
    for a denormal quaternion it would overflow float32.
    """
    largest = quat.detach().abs().amax(dim=-1, keepdim=True)
    identity = torch.tensor([1, 0, 0, 0], dtype=quat.dtype, device=quat.device)
    quat = torch.where(largest > 0, quat / torch.where(largest > 0, largest, 1), identity)
    norm = quat.norm(dim=-1, keepdim=True)
    unit = quat / norm
    gradient_scale = (largest * norm.detach() * MAX_INVERSE_NORM).clamp(max=1)
    return torch.where(gradient_scale < 1, unit.detach() + gradient_scale * (unit - unit.detach()), unit)


def rotation_4d(quat_left: Tensor, quat_right: Tensor) -> Tensor:
    """R = L(ql) R(qr), (N, 4, 4): the map v -> ql v qr of v = (x, y, z, t) = x + yi + zj + tk (docs/method.md 1)."""
    a, b, c, d = normalise_quaternion(quat_left).unbind(-1)
    p, q, r, s = normalise_quaternion(quat_right).unbind(-1)
    left = torch.stack([a, -b, -c, -d, b, a, -d, c, c, d, a, -b, d, -c, b, a], dim=-1).reshape(-1, 4, 4)
    right = torch.stack([p, -q, -r, -s, q, p, s, -r, r, -s, p, q, s, r, -q, p], dim=-1).reshape(-1, 4, 4)
    return left @ right


def time_row(quat_left: Tensor, quat_right: Tensor) -> Tensor:
    """The last row of R = L(ql) R(qr), (N, 4): how far each axis of the ellipsoid reaches into time."""
    a, b, c, d = normalise_quaternion(quat_left).unbind(-1)
    p, q, r, s = normalise_quaternion(quat_right).unbind(-1)
    return torch.stack([
        d * p - c * q + b * r + a * s, a * r - b * s - c * p - d * q,
        b * p - a * q - c * s - d * r, a * p + b * q + c * r - d * s,
    ], dim=-1)  # fmt: skip


def rotation_3d(quat: Tensor) -> Tensor:
    """Rotation matrices (N, 3, 3) of quaternions (N, 4) in the order w, x, y, z, as in 3D Gaussian Splatting."""
    w, x, y, z = normalise_quaternion(quat).unbind(-1)
    return torch.stack([
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ], dim=-1).reshape(-1, 3, 3)  # fmt: skip


def scaled_axes(gaussians: Gaussians) -> Tensor:
    """M with Σ = M Mᵀ (docs/method.md 1): (N, 4, 4), or (N, 3, 3) for a static model. M = R diag(s).

    Without 4D rotation, R rotates space only: Σ is block diagonal and the Gaussians do not move. With velocities v, the
    last column of M is st (v, 1).
    """
    if gaussians.quat_right is not None:
        rotation = rotation_4d(gaussians.quat_left, gaussians.quat_right)
    else:
        rotation = rotation_3d(gaussians.quat_left)
        if gaussians.motion != "static":
            rotation = F.pad(rotation, (0, 1, 0, 1))
            rotation = rotation + torch.diag(rotation.new_tensor([0, 0, 0, 1]))
    axes = rotation * gaussians.log_scale.exp()[:, None, :]
    if gaussians.velocity is not None:
        moved = gaussians.velocity * gaussians.log_scale[:, 3:].exp()
        axes = axes + F.pad(moved[:, :, None], (3, 0, 0, 1))
    return axes


def temporal_deviation(gaussians: Gaussians) -> Tensor:
    """√Σtt, the standard deviation of the temporal marginal of each Gaussian of a dynamic model: (N,), units of time.

    Σtt = Σ_j (R_tj s_j)²; without 4D rotation it is st². A strong rotation turns a long spatial axis into time.
    """
    scales = gaussians.log_scale.exp()
    if gaussians.quat_right is None:
        return scales[:, 3]
    return (time_row(gaussians.quat_left, gaussians.quat_right) * scales).norm(dim=1)
