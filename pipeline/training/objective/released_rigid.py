"""The rigid loss of the released program (commit 63725f2), which uses it on one scene, D-NeRF's lego.

It is the sum of exp(-100 d) |u_i - u_j| / (N k) over all N Gaussians i and the k means nearest to μ_i, of which μ_i is
one. u = Σ_xyz,t / Σtt × 0.1 duration is the displacement of the conditional mean in a tenth of the duration
(docs/method.md 1.1); the distance d is constant in the gradient.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from scipy.spatial import cKDTree
from torch import Tensor

from pipeline.model.model import Model
from pipeline.training.objective.terms import DrawnView
from rasterizer import Gradients
from rasterizer.covariance import rotation_4d

NEIGHBOURS = 20  # k
FALLOFF = 100.0  # per world unit
VELOCITY_STEP = 0.1  # × the duration; the release's, whose duration is 1
FIELDS = ("mean", "log_scale", "quat_left", "quat_right")  # that the loss depends on


@dataclass(frozen=True)
class ReleasedRigid:
    """`weight` × `released_rigid_loss`, once in a batch, because it is the same for all views."""

    weight: float
    duration: float  # of the scene
    threads: int

    def add(self, gradients: Gradients, model: Model, view: DrawnView) -> float:
        if model.kind.motion != "full" or view.place != 0:
            return 0.0
        leaves = {name: model.parameters[name].detach().requires_grad_() for name in FIELDS}
        with torch.enable_grad():
            loss = self.weight * released_rigid_loss(leaves, self.duration, NEIGHBOURS, self.threads)
        if not loss.requires_grad:  # a single Gaussian
            return 0.0
        for name, gradient in zip(FIELDS, torch.autograd.grad(loss, list(leaves.values()), allow_unused=True)):
            if gradient is not None:
                getattr(gradients, name).add_(gradient)
        return view.batch * loss.item()


def released_rigid_loss(fields: dict[str, Tensor], duration: float, neighbours: int, threads: int = 1) -> Tensor:
    """A scalar of the parameters FIELDS. neighbours: k."""
    mean = fields["mean"]
    others = min(neighbours, len(mean)) - 1
    if others < 1:
        return mean.new_zeros(())
    positions = mean[:, :3].detach().cpu().double().numpy()
    found = cKDTree(positions).query(positions, k=others + 1, workers=threads)
    columns = (column[:, 1:] for column in found)  # the first is the Gaussian itself
    distance, index = (torch.from_numpy(column).to(mean.device) for column in columns)
    step = _velocity(fields) * (VELOCITY_STEP * duration)
    difference = step[index] - step[:, None]
    # The gradient of a square root is infinite at 0, and unrotated Gaussians all have velocity 0.
    speeds = torch.sqrt((difference**2).sum(dim=2) + 1e-20)
    return (torch.exp(-FALLOFF * distance.to(mean.dtype)) * speeds).sum() / (len(mean) * neighbours)


def _velocity(fields: dict[str, Tensor]) -> Tensor:
    """(N, 3) Σ_xyz,t / Σtt, world units per unit of time."""
    axes = rotation_4d(fields["quat_left"], fields["quat_right"]) * fields["log_scale"].exp()[:, None, :]  # M
    row = axes[:, 3]
    return (axes[:, :3] @ row[:, :, None])[:, :, 0] / (row * row).sum(dim=1)[:, None]
