"""Trajectories that many Gaussians share: displacements and rotations as uniform cubic B-splines in time.

Trajectory k is a sum over levels j of n_j intervals and n_j + 3 control points each, n_j = 2, …, n/4, n/2, n: coarse
levels learn what takes long, fine ones what is fast. With u = (t - start) / (end - start), clamped to [0, 1],

    (c_k, r_k)(t) = Σ_j Σ_p B_jp(u) P_jpk.

A Gaussian of weights w is displaced by Σ_k w_k c_k(t), world units, and turned by the rotation vector Σ_k w_k r_k(t).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
from torch import Tensor

MAX_INTERVALS = 4096  # of the finest level


def level_intervals(finest: int) -> tuple[int, ...]:
    """Intervals of the levels, coarse to fine, from those of the finest, at least 2; halves are rounded up."""
    return (2,) if finest == 2 else (*level_intervals((finest + 1) // 2), finest)


# Intervals of the levels, by the number of control points of all of them.
LEVELS = {sum(n + 3 for n in level_intervals(n)): level_intervals(n) for n in range(2, MAX_INTERVALS + 1)}
COLUMNS = 16  # of the kernel's table: displacement, rotation vector, drift, and zeros


@dataclass(frozen=True)
class Trajectories:
    """K shared trajectories. Raises ValueError for a wrong shape or span."""

    control_points: Tensor  # (C, K, 6) P: displacement in world units, rotation vector in radians; C of LEVELS
    span: tuple[float, float] = (0.0, 1.0)  # first and last time; before and after, the trajectories stand still

    def __post_init__(self) -> None:
        shape = list(self.control_points.shape)
        if len(shape) != 3 or shape[0] not in LEVELS or shape[1] < 1 or shape[2] != 6:
            raise ValueError(f"trajectories must be [C, K, 6] with C among {[*LEVELS][:5]} …, got {shape}")
        if not self.span[0] < self.span[1]:
            raise ValueError(f"the span of the trajectories must ascend, got {self.span}")

    def __len__(self) -> int:
        return self.control_points.shape[1]

    @classmethod
    def still(cls, count: int, intervals: int, span: tuple[float, float]) -> Trajectories:
        """`count` trajectories that do not move, with so many intervals in the finest level."""
        return cls(torch.zeros(sum(n + 3 for n in level_intervals(intervals)), count, 6), span)

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
        return (basis.to(points.device) @ points.flatten(1)).view(points.shape[1:]).to(self.control_points.dtype)


@lru_cache(maxsize=4096)
def _basis(time: float, span: tuple[float, float], count: int, derivative: bool) -> Tensor:
    """(count,) float64 B(u) of all levels, or its derivative by time."""
    start, end = span
    u = (time - start) / (end - start)
    levels = []
    for intervals in LEVELS[count]:
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
