"""Rigidity of shared motion: neighbours move along the trajectories as a rigid body would.

With x_i(t) the displaced mean of Gaussian i and R_i(t) the rotation by its trajectories, the loss of a pair of near
neighbours is |(x_j - x_i) - R_i (μ_j - μ_i)|² / (|μ_j - μ_i|² + s²), s the median distance to the fourth neighbour. It
is zero for any rigid motion.
"""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from datasets.scene import Scene
from pipeline.config.random_streams import Stream, stream
from pipeline.model.model import Model
from pipeline.training.objective.terms import DrawnView
from rasterizer import Gradients
from rasterizer.covariance import rotation_3d
from rasterizer.reference.render import turning

NEIGHBOURS = 8  # nearest Gaussians that a Gaussian is compared with
# All at one time, in every iteration: with more in every eighth D-NeRF's hook loses 2.5 dB.
PAIRS = 2000


class RigidNeighbours:
    """`weight` × the mean loss of PAIRS random pairs at a random time, once a batch."""

    def __init__(self, weight: float, scene: Scene, seed: int) -> None:
        self.weight, self._scene, self._seed = weight, scene, seed

    def add(self, gradients: Gradients, model: Model, view: DrawnView) -> float:
        trajectories, weights = model.trajectories, model.parameters.get("weights")
        if trajectories is None or weights is None or view.place != 0 or len(model) <= NEIGHBOURS:
            return 0.0
        rng = stream(self._seed, Stream.RIGID, view.number)
        first = torch.from_numpy(rng.integers(0, len(model), PAIRS))
        means = model.parameters["mean"][:, :3]
        positions = means.cpu().numpy()
        distance, index = cKDTree(positions, balanced_tree=False).query(positions[first], k=NEIGHBOURS + 1)
        # Column 0 is the Gaussian itself.
        second = torch.from_numpy(index[np.arange(PAIRS), rng.integers(1, NEIGHBOURS + 1, PAIRS)])
        first, second = first.to(model.device), second.to(model.device)
        softening = float(np.median(distance[:, 4])) ** 2
        basis = trajectories.basis(self._scene.time_start + self._scene.duration * rng.random()).to(means)
        points = trajectories.control_points.detach().requires_grad_()
        of_first, of_second = (weights[rows].requires_grad_() for rows in (first, second))
        with torch.enable_grad():
            values = (basis @ points.flatten(1)).view(points.shape[1:])
            losses = rigid_losses(means[second] - means[first], of_first @ values, of_second @ values, softening)
            loss = self.weight * losses.mean()
        d_first, d_second, d_points = torch.autograd.grad(loss, (of_first, of_second, points))
        assert gradients.weights is not None and gradients.trajectories is not None
        gradients.weights.index_add_(0, first, d_first).index_add_(0, second, d_second)
        gradients.trajectories += d_points
        return view.batch * loss.item()


def rigid_losses(apart: Tensor, first: Tensor, second: Tensor, softening: float) -> Tensor:
    """(P,) losses of pairs: apart (P, 3) = μ_j - μ_i; first, second (P, 6) displacements and rotation vectors of i, j;
    softening: s²."""
    rotated = (rotation_3d(turning(first[:, 3:])) @ apart[:, :, None])[:, :, 0]
    error = apart + second[:, :3] - first[:, :3] - rotated
    return error.square().sum(dim=1) / (apart.square().sum(dim=1) + softening)
