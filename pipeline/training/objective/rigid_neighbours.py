"""Rigidity of shared motion: neighbours move along the trajectories as a rigid body would.

With x_i(t) the displaced mean of Gaussian i and R_i(t) the rotation by its trajectories, the loss of a pair of near
neighbours is |(x_j - x_i) - R_i (μ_j - μ_i)|² / (|μ_j - μ_i|² + s²), s the median distance to the fourth neighbour. It
is zero for any rigid motion. Its gradient is written out: autograd takes three times as long.
"""

from __future__ import annotations

import torch
from torch import Tensor

from datasets.scene import Scene
from pipeline.config.random_streams import Stream, stream
from pipeline.model.model import Model
from pipeline.training.objective.neighbours import NEIGHBOURS
from pipeline.training.objective.terms import DrawnView
from rasterizer import Gradients

# All at one time, in every iteration: with more in every eighth D-NeRF's hook loses 2.5 dB.
PAIRS = 2000
SMALLEST_ANGLE2 = 1e-12  # squared radians, a divisor


class RigidNeighbours:
    """`weight` × the mean loss of PAIRS random pairs at a random time, once a batch."""

    def __init__(self, weight: float, scene: Scene, seed: int) -> None:
        self.weight, self._scene, self._seed = weight, scene, seed

    def add(self, gradients: Gradients, model: Model, view: DrawnView) -> float:
        trajectories, weights = model.trajectories, model.parameters.get("weights")
        if trajectories is None or weights is None or view.neighbours is None:
            return 0.0
        rng = stream(self._seed, Stream.RIGID, view.number)
        first, place = (torch.from_numpy(rng.integers(0, count, PAIRS)) for count in (len(model), NEIGHBOURS))
        second = view.neighbours.index[first, place].long()
        rows = torch.cat([first, second]).to(model.device)
        means = model.parameters["mean"].index_select(0, rows)[:, :3]
        basis = trajectories.basis(self._scene.time_start + self._scene.duration * rng.random()).to(means)
        points = trajectories.control_points
        values = (basis @ points.flatten(1)).view(points.shape[1:])
        followed = weights.index_select(0, rows)
        losses, gradient = rigid_losses(means[PAIRS:] - means[:PAIRS], followed @ values, view.neighbours.spacing**2)
        gradient *= self.weight / PAIRS
        assert gradients.weights is not None and gradients.trajectories is not None
        gradients.weights.index_add_(0, rows, gradient @ values.T)
        gradients.trajectories += basis[:, None, None] * (followed.T @ gradient)
        return view.batch * self.weight * losses.mean().item()


def rigid_losses(apart: Tensor, moved: Tensor, softening: float) -> tuple[Tensor, Tensor]:
    """The (P,) losses of pairs, and each one's gradient by `moved`, (2 P, 6).

    apart: (P, 3) μ_j - μ_i. moved: (2 P, 6) displacements and rotation vectors of i, then of j. softening: s².
    """
    first, second = moved.chunk(2)
    # R a = a + 2 c v × a + 2 v × (v × a) with c = cos(θ/2), v = s r, s = sin(θ/2)/θ of the rotation vector r, θ = |r|.
    turn = first[:, 3:]
    angle2 = turn.square().sum(dim=1, keepdim=True).clamp_min(SMALLEST_ANGLE2)
    angle = angle2.sqrt()
    cosine, sine = torch.cos(0.5 * angle), torch.sin(0.5 * angle) / angle
    axis = sine * turn
    across = torch.linalg.cross(axis, apart)
    rotated = apart + 2 * (cosine * across + torch.linalg.cross(axis, across))
    error = apart + second[:, :3] - first[:, :3] - rotated
    inverse = 1 / (apart.square().sum(dim=1, keepdim=True) + softening)
    d_error = 2 * inverse * error
    # Back through R a, whose gradient is -d_error: to c, v × a and v, then to r.
    d_cosine = -2 * (d_error * across).sum(dim=1, keepdim=True)
    d_across = -2 * (cosine * d_error + torch.linalg.cross(d_error, axis))
    d_axis = torch.linalg.cross(apart, d_across) - 2 * torch.linalg.cross(across, d_error)
    along = (d_axis * turn).sum(dim=1, keepdim=True)
    d_turn = sine * d_axis + ((0.5 * cosine - sine) / angle2 * along - 0.5 * sine * d_cosine) * turn
    losses = (error.square().sum(dim=1, keepdim=True) * inverse)[:, 0]
    d_first, d_second = torch.cat([-d_error, d_turn], dim=1), torch.cat([d_error, torch.zeros_like(d_error)], dim=1)
    return losses, torch.cat([d_first, d_second])
