"""The rigid loss: differences between the velocities of neighbouring Gaussians.

It is the released program's, not the paper's; the release uses it on one scene, D-NeRF's lego, in every view and with
20 neighbours. `fast` uses it in one view of 32 and with 8 neighbours, which takes a fortieth of the time. It applies to
models with 4D rotation or velocities, because no others move.
"""

from __future__ import annotations

import torch
from scipy.spatial import cKDTree
from torch import Tensor

from pipeline.model.model import Model
from rasterizer import Gradients
from rasterizer.covariance import rotation_4d, time_row

FALLOFF = 100.0  # weight exp(-100 d²), d in world units: 1/e at 0.1
MIN_MARGINAL = 0.7  # only Gaussians with temporal marginal p(t) above this
# Velocities are displacements per this fraction of the duration; the release uses 0.1 with D-NeRF's duration of 1.
VELOCITY_STEP = 0.1

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
    position = (mean[:, :3] + velocity * (time - mean[:, 3:])).detach()
    step = velocity * (VELOCITY_STEP * duration)

    points = position.double().numpy()
    count = min(neighbours, len(points) - 1)
    distance, index = cKDTree(points).query(points, k=count + 1, workers=threads)
    weight = torch.exp(-FALLOFF * torch.from_numpy(distance[:, 1:]).to(mean.dtype) ** 2)  # column 0 is the point itself
    difference = step[torch.from_numpy(index[:, 1:])] - step[:, None]
    # The gradient of a square root is infinite at 0, and unrotated Gaussians all have velocity 0.
    relative_speed = torch.sqrt((difference**2).sum(dim=2) + 1e-20)
    return (weight * relative_speed).mean()


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
    gradients: Gradients, model: Model, time: float, duration: float, neighbours: int, weight: float, threads: int = 1
) -> float:
    """Add weight × ∂(rigid loss)/∂parameters to `gradients`, in place; returns weight × loss."""
    leaves = {name: p.detach().requires_grad_() for name, p in model.parameters.items() if name in FIELDS}
    with torch.enable_grad():
        loss = weight * rigid_loss(leaves, time, duration, neighbours, threads)
    if not loss.requires_grad:
        return 0.0
    for name, grad in zip(leaves, torch.autograd.grad(loss, list(leaves.values()), allow_unused=True)):
        if grad is not None:
            getattr(gradients, name).add_(grad)
    return loss.item()
