"""Reference implementation of 4D spherical harmonics: colour by viewing direction and time (docs/method.md 1.4).

Any floating-point type, differentiable.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

# Normalisations of the real spherical harmonics of degree 0..3 (Sloan, "Stupid Spherical Harmonics Tricks").
_C0 = math.sqrt(1 / (4 * math.pi))
_C1 = math.sqrt(3 / (4 * math.pi))
_C2 = (math.sqrt(15 / (4 * math.pi)), math.sqrt(5 / (16 * math.pi)), math.sqrt(15 / (16 * math.pi)))
_C3 = (
    math.sqrt(35 / (32 * math.pi)),
    math.sqrt(105 / (4 * math.pi)),
    math.sqrt(21 / (32 * math.pi)),
    math.sqrt(7 / (16 * math.pi)),
    math.sqrt(105 / (16 * math.pi)),
)


def sh_basis(direction: Tensor, degree: int) -> Tensor:
    """Real spherical harmonics Y_lm of unit vectors (N, 3) for l <= degree, m = -l..l: (N, (degree+1)²).

    Signs follow 3D Gaussian Splatting, which keeps the Condon-Shortley phase: Y_1 = C1 (-y, z, -x).
    """
    x, y, z = direction.unbind(-1)
    xx, yy, zz = x * x, y * y, z * z
    basis = [_C0 * torch.ones_like(x)]
    if degree >= 1:
        basis += [-_C1 * y, _C1 * z, -_C1 * x]
    if degree >= 2:
        basis += [_C2[0] * x * y, -_C2[0] * y * z, _C2[1] * (2 * zz - xx - yy), -_C2[0] * x * z, _C2[2] * (xx - yy)]
    if degree >= 3:
        basis += [
            -_C3[0] * y * (3 * xx - yy),
            _C3[1] * x * y * z,
            -_C3[2] * y * (4 * zz - xx - yy),
            _C3[3] * z * (2 * zz - 3 * xx - 3 * yy),
            -_C3[2] * x * (4 * zz - xx - yy),
            _C3[4] * z * (xx - yy),
            -_C3[0] * x * (xx - 3 * yy),
        ]
    return torch.stack(basis, dim=-1)


def fourier_basis(elapsed: Tensor, duration: float, order: int) -> Tensor:
    """cos(2πn (t-μt)/T), (N, order+1), for n = 0..order; elapsed: t - μt (N,); duration: T in the same unit."""
    return torch.stack([torch.cos(2 * math.pi * n / duration * elapsed) for n in range(order + 1)], dim=-1)


def sh_color(
    coefficients: Tensor,  # (N, n+1, (l+1)², 3) k_nlm
    direction: Tensor,  # (N, 3) unit, from the camera to μ(t)
    elapsed: Tensor | None,  # (N,) t - μt; None for a static model
    duration: float,
    wrong_line: bool = False,
) -> Tensor:
    """RGB (N, 3) = max(0, ½ + Σ_n Σ_lm k_nlm cos(2πn (t-μt)/T) Y_lm(d)); no gradient where the sum is negative.

    wrong_line: ∂RGB/∂k_0,1,-1 is Y_00 in place of Y_1,-1; RGB is the same (docs/baseline.md).
    """
    order, degree = coefficients.shape[1] - 1, math.isqrt(coefficients.shape[2]) - 1
    space = sh_basis(direction, degree)
    time = torch.ones_like(space[:, :1]) if elapsed is None else fourier_basis(elapsed, duration, order)
    total = 0.5 + torch.einsum("nf,nb,nfbc->nc", time, space, coefficients)
    if wrong_line and degree > 0:
        wrong = coefficients[:, 0, 1]
        total = total + (space[:, :1] - space[:, 1:2]).detach() * (wrong - wrong.detach())
    return torch.relu(total)
