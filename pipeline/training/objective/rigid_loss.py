"""The rigid loss: differences between the velocities of neighbouring Gaussians.

`released_rigid_loss` is that of the released program (commit 63725f2), which uses it on one scene, D-NeRF's lego; the
paper has none. `rigid_loss` is ours: it compares the Gaussians that are visible at a moment, where they are then, and
its weight falls with the square of their distance. `fast` uses it in one view of 32. Both apply to models with 4D
rotation or velocities, because no others move.
"""

from __future__ import annotations

import torch
from scipy.spatial import cKDTree
from torch import Tensor

from pipeline.model.model import Model
from rasterizer import Gradients
from rasterizer.covariance import rotation_4d, time_row

FALLOFF = 100.0  # weight exp(-100 d²), d in world units: 1/e at 0.1; the release's exp(-100 d)
MIN_MARGINAL = 0.7  # only Gaussians with temporal marginal p(t) above this
# Velocities are displacements per this fraction of the duration; the release uses 0.1 with D-NeRF's duration of 1.
VELOCITY_STEP = 0.1
NEIGHBOURS = 8  # nearest Gaussians that a Gaussian is compared with
RELEASED_NEIGHBOURS = 20  # the same in the released form
RIGID_EVERY = 32  # `rigid_loss` is that of every such training view, × this, for run time; the release's of every step

# That the loss depends on; a model has one of the last two, and without 4D rotation neither.
FIELDS = ("mean", "log_scale", "quat_left", "quat_right", "velocity")


def rigid_loss(fields: dict[str, Tensor], time: float, duration: float, neighbours: int, threads: int = 1) -> Tensor:
    """Mean of exp(-100 d²) |u_i - u_j| over the Gaussians i with p(t) > MIN_MARGINAL and their neighbours j; scalar.

    u = Σ_xyz,t / Σtt × 0.1 duration is the displacement of the conditional mean in a tenth of the duration
    (docs/method.md 1.1). d is the distance at `time`, constant in the gradient. fields: the parameters among FIELDS.
    """
    moving = _moving_at(fields, time)
    fields = {name: tensor[moving] for name, tensor in fields.items()}
    mean = fields["mean"]
    if len(mean) < 2:
        return mean.new_zeros(())
    velocity = _velocity(fields)
    position = mean[:, :3] + velocity * (time - mean[:, 3:])
    distance, index = _nearest(position, min(neighbours, len(mean) - 1), threads)
    return (torch.exp(-FALLOFF * distance**2) * _relative_speeds(velocity, index, duration)).mean()


def released_rigid_loss(fields: dict[str, Tensor], duration: float, neighbours: int, threads: int = 1) -> Tensor:
    """Sum of exp(-100 d) |u_i - u_j| / (N k) over all N Gaussians i and the k = `neighbours` means nearest to μ_i, of
    which μ_i is one; scalar. u and the rest as in `rigid_loss`."""
    mean = fields["mean"]
    others = min(neighbours, len(mean)) - 1
    if others < 1:
        return mean.new_zeros(())
    distance, index = _nearest(mean[:, :3], others, threads)
    speeds = _relative_speeds(_velocity(fields), index, duration)
    return (torch.exp(-FALLOFF * distance) * speeds).sum() / (len(mean) * neighbours)


def _nearest(points: Tensor, count: int, threads: int) -> tuple[Tensor, Tensor]:
    """Distances and numbers (N, count) of the nearest other points, without gradient."""
    positions = points.detach().double().numpy()
    distance, index = cKDTree(positions).query(positions, k=count + 1, workers=threads)
    return torch.from_numpy(distance[:, 1:]).to(points.dtype), torch.from_numpy(index[:, 1:])  # 0 is the point itself


def _relative_speeds(velocity: Tensor, index: Tensor, duration: float) -> Tensor:
    """(N, count) |u_i - u_j| of the Gaussians i and those that `index` names."""
    step = velocity * (VELOCITY_STEP * duration)
    difference = step[index] - step[:, None]
    # The gradient of a square root is infinite at 0, and unrotated Gaussians all have velocity 0.
    return torch.sqrt((difference**2).sum(dim=2) + 1e-20)


def _velocity(fields: dict[str, Tensor]) -> Tensor:
    """(N, 3) Σ_xyz,t / Σtt, world units per unit of time."""
    if "velocity" in fields:
        return fields["velocity"]
    axes = rotation_4d(fields["quat_left"], fields["quat_right"]) * fields["log_scale"].exp()[:, None, :]  # M
    row = axes[:, 3]
    variance = (row * row).sum(dim=1)  # Σtt
    return (axes[:, :3] @ row[:, :, None])[:, :, 0] / variance[:, None]


@torch.no_grad()
def _moving_at(fields: dict[str, Tensor], time: float) -> Tensor:
    """(N,) bool: p(t) > MIN_MARGINAL. Most are not, and need no gradient."""
    scales = fields["log_scale"].exp()
    axes = scales[:, 3:] if "velocity" in fields else time_row(fields["quat_left"], fields["quat_right"]) * scales
    return torch.exp(-0.5 * (time - fields["mean"][:, 3]) ** 2 / (axes * axes).sum(dim=1)) > MIN_MARGINAL


def add_rigid_gradient(
    gradients: Gradients,
    model: Model,
    time: float | None,
    duration: float,
    neighbours: int,
    weight: float,
    threads: int = 1,
) -> float:
    """Add weight × ∂(rigid loss)/∂parameters to `gradients`, in place; returns weight × loss.

    time: of `rigid_loss`; None: `released_rigid_loss`.
    """
    leaves = {name: p.detach().requires_grad_() for name, p in model.parameters.items() if name in FIELDS}
    with torch.enable_grad():
        if time is None:
            loss = weight * released_rigid_loss(leaves, duration, neighbours, threads)
        else:
            loss = weight * rigid_loss(leaves, time, duration, neighbours, threads)
    if not loss.requires_grad:
        return 0.0
    for name, grad in zip(leaves, torch.autograd.grad(loss, list(leaves.values()), allow_unused=True)):
        if grad is not None:
            getattr(gradients, name).add_(grad)
    return loss.item()
