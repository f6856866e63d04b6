"""Trajectories that many Gaussians share: displacements and rotations as uniform cubic B-splines in time.

Trajectory k is a sum over levels j = 1 … J, of 2^j intervals and 2^j + 3 control points each: coarse levels learn what
takes long, fine ones what is fast. With u = (t - start) / (end - start), clamped to [0, 1],

    (c_k, r_k)(t) = Σ_j Σ_p B_jp(u) P_jpk.

A Gaussian of weights w is displaced by Σ_k w_k c_k(t), world units, and turned by the rotation vector Σ_k w_k r_k(t).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
from torch import Tensor

MAX_LEVELS = 12  # 4096 intervals
CONTROL_POINTS = {sum(2**j + 3 for j in range(1, levels + 1)): levels for levels in range(1, MAX_LEVELS + 1)}
COLUMNS = 16  # of the kernel's table: displacement, rotation vector, drift, and zeros


@dataclass(frozen=True)
class Trajectories:
    """K shared trajectories. Raises ValueError for a wrong shape or span."""

    control_points: Tensor  # (C, K, 6) P: displacement in world units, rotation vector in radians; C of CONTROL_POINTS
    span: tuple[float, float] = (0.0, 1.0)  # first and last time; before and after, the trajectories stand still

    def __post_init__(self) -> None:
        shape = list(self.control_points.shape)
        if len(shape) != 3 or shape[0] not in CONTROL_POINTS or shape[1] < 1 or shape[2] != 6:
            raise ValueError(f"trajectories must be [C, K, 6] with C among {[*CONTROL_POINTS]}, got {shape}")
        if not self.span[0] < self.span[1]:
            raise ValueError(f"the span of the trajectories must ascend, got {self.span}")

    def __len__(self) -> int:
        return self.control_points.shape[1]

    @classmethod
    def still(cls, count: int, levels: int, span: tuple[float, float]) -> Trajectories:
        """`count` trajectories of `levels` levels that do not move."""
        points = next(points for points, found in CONTROL_POINTS.items() if found == levels)
        return cls(torch.zeros(points, count, 6), span)

    def values(self, time: float) -> Tensor:
        """(K, 6) displacements and rotation vectors at the time."""
        return self._combined(self.basis(time))

    def drift(self, time: float, dt: float) -> Tensor:
        """(K, 3) mean velocity of the displacements until time + dt, world units per unit of time; dt = 0: at time."""
        return self._combined(self.drift_basis(time, dt))[:, :3]

    def basis(self, time: float) -> Tensor:
        """(C,) float64 B(u)."""
        return _basis(time, self.span, len(self.control_points), False)

    def drift_basis(self, time: float, dt: float) -> Tensor:
        """(C,) float64: what `drift` weights the control points by."""
        if dt == 0:
            return _basis(time, self.span, len(self.control_points), True)
        return (self.basis(time + dt) - self.basis(time)) / dt

    def table(self, time: float, flow_dt: float | None) -> Tensor:
        """(K, 16) the trajectories at one time, as the kernel reads them. flow_dt: None without optical flow."""
        points = self.control_points.detach()
        table = torch.zeros(len(self), COLUMNS, dtype=points.dtype)
        table[:, :6] = self._combined(self.basis(time))
        if flow_dt is not None:
            table[:, 6:9] = self.drift(time, flow_dt)
        return table

    def add_gradient(self, gradient: Tensor, d_table: Tensor, time: float, flow_dt: float | None) -> None:
        """Add ∂L/∂control points (C, K, 6) to `gradient`, in place, from that of `table(time, flow_dt)`."""
        d_table = d_table.double()
        found = self.basis(time)[:, None, None] * d_table[:, :6]
        if flow_dt is not None:
            found[:, :, :3] += self.drift_basis(time, flow_dt)[:, None, None] * d_table[:, 6:9]
        gradient += found.to(gradient.dtype)

    def _combined(self, basis: Tensor) -> Tensor:
        points = self.control_points.double()
        return (basis @ points.flatten(1)).view(points.shape[1:]).to(self.control_points.dtype)


@lru_cache(maxsize=4096)
def _basis(time: float, span: tuple[float, float], count: int, derivative: bool) -> Tensor:
    """(count,) float64 B(u) of all levels, or its derivative by time."""
    start, end = span
    u = (time - start) / (end - start)
    levels = []
    for level in range(1, CONTROL_POINTS[count] + 1):
        intervals = 2**level
        position = min(max(u, 0.0), 1.0) * intervals
        first = min(int(position), intervals - 1)
        v = position - first
        row = np.zeros(intervals + 3)
        if not derivative:
            row[first : first + 4] = (1 - v) ** 3, 3 * v**3 - 6 * v**2 + 4, -3 * v**3 + 3 * v**2 + 3 * v + 1, v**3
        elif 0 <= u <= 1:
            row[first : first + 4] = -3 * (1 - v) ** 2, 9 * v**2 - 12 * v, -9 * v**2 + 6 * v + 3, 3 * v**2
            row *= intervals / (end - start)
        levels.append(row / 6)
    return torch.from_numpy(np.concatenate(levels))
