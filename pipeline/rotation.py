"""Quaternions to rotation matrices (SPEC 1), differentiable, for the few places outside the rasterizer."""

from __future__ import annotations

import torch
from torch import Tensor


def _unit(quat: Tensor) -> tuple[Tensor, ...]:
    """(n, 4) -> four (n,) components of the normalised quaternion; zero is read as identity."""
    norm = quat.norm(dim=1, keepdim=True)
    identity = quat.new_tensor([1.0, 0.0, 0.0, 0.0])
    unit = torch.where(norm > 0, quat / norm.clamp(min=torch.finfo(quat.dtype).tiny), identity)
    return unit.unbind(dim=1)


def _matrix(rows: list[list[Tensor]]) -> Tensor:
    return torch.stack([torch.stack(row, dim=1) for row in rows], dim=1)


def rotation_4d(left: Tensor, right: Tensor) -> Tensor:
    """R = L(ql) R(qr), (n, 4), (n, 4) -> (n, 4, 4); rows and columns x, y, z, t."""
    a, b, c, d = _unit(left)
    p, q, r, s = _unit(right)
    left_matrix = _matrix([[a, -b, -c, -d], [b, a, -d, c], [c, d, a, -b], [d, -c, b, a]])
    right_matrix = _matrix([[p, -q, -r, -s], [q, p, s, -r], [r, -s, p, q], [s, r, -q, p]])
    return left_matrix @ right_matrix


def rotation_3d(quat: Tensor) -> Tensor:
    """Rotation matrix of (w, x, y, z), (n, 4) -> (n, 3, 3)."""
    w, x, y, z = _unit(quat)
    return _matrix([[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                    [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                    [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]])
