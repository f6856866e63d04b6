"""Spatial rotation and tilt: what the two quaternions of a 4D rotation do to space, and to space and time together.

With v = (x, y, z, t) = x + yi + zj + tk rotated to ql v qr (docs/method.md 1), the time axis is fixed if ql k qr = k,
which holds for ql = (a, b, c, d) and qr = (a, b, c, -d), both of unit length. The rotation is one of space alone then,
and the Gaussian does not move. The distance of qr from that is the tilt; it makes the Gaussian move.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

UNTILTED = torch.tensor([1.0, 1.0, 1.0, -1.0])  # × ql is the qr without tilt


def spatial_and_tilt(of_left: Tensor, of_right: Tensor) -> tuple[Tensor, Tensor]:
    """Coordinates of a change of (ql, qr), or of the gradient with respect to them: (N, 4) each.

    With l = ql × UNTILTED they are (l + qr) / √2, which rotates space to first order in the tilt, and (qr - l) / √2,
    which tilts. The map is orthogonal, so that gradients transform as changes do.
    """
    left = of_left * UNTILTED.to(of_left.dtype)
    return (left + of_right) * math.sqrt(0.5), (of_right - left) * math.sqrt(0.5)


def left_and_right(spatial: Tensor, tilted: Tensor) -> tuple[Tensor, Tensor]:
    """The inverse of spatial_and_tilt: (of_left, of_right), (N, 4) each."""
    left, right = (spatial - tilted) * math.sqrt(0.5), (spatial + tilted) * math.sqrt(0.5)
    return left * UNTILTED.to(left.dtype), right
