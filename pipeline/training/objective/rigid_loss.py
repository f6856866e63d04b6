"""The release's rigid loss: neighbours should move alike. Only for models with 4D rotation, which alone can move.

Not in the paper; the release uses it for D-NeRF's lego with weight 1. It costs a k-nearest-neighbour search a view.
"""

from __future__ import annotations

import torch
from scipy.spatial import cKDTree
from torch import Tensor

from pipeline.model.model import Model
from rasterizer import Gradients
from rasterizer.covariance import rotation_4d

NEIGHBOURS = 20
FALLOFF = 100.0  # weight exp(-100 d²), d in world units: 0.1 away counts 1/e
MIN_MARGINAL = 0.7  # only Gaussians well inside their time, p(t) above this
# Velocity is a displacement over this part of the duration; the release moves 0.1 on D-NeRF's duration of 1.
VELOCITY_STEP = 0.1


def rigid_loss(
    mean: Tensor,
    log_scale: Tensor,
    quat_left: Tensor,
    quat_right: Tensor,
    time: float,
    duration: float,
    threads: int = 1,
) -> Tensor:
    """Mean over Gaussians alive at `time`, and their neighbours j, of exp(-100 d²) |u_i - u_j|; scalar.

    u = Σ_xyz,t / Σtt × 0.1 duration, how far the conditional mean moves in a tenth of the duration (docs/method.md
    1.1); d is the distance at `time`, held constant in the gradient. Differentiable in all four tensors, (N, 4) each.
    """
    rotation = rotation_4d(quat_left, quat_right)
    axes = rotation * log_scale.exp()[:, None, :]  # M = R diag(s)
    time_row = axes[:, 3]
    variance = (time_row * time_row).sum(dim=1)  # Σtt
    elapsed = time - mean[:, 3]
    alive = torch.exp(-0.5 * elapsed.detach() ** 2 / variance.detach()) > MIN_MARGINAL
    if int(alive.sum()) < 2:
        return mean.new_zeros(())
    velocity = (axes[alive, :3] @ time_row[alive, :, None])[:, :, 0] / variance[alive, None]
    place = (mean[alive, :3] + velocity * elapsed[alive, None]).detach()
    step = velocity * (VELOCITY_STEP * duration)

    points = place.double().numpy()
    count = min(NEIGHBOURS, len(points) - 1)
    distance, index = cKDTree(points).query(points, k=count + 1, workers=threads)
    weight = torch.exp(-FALLOFF * torch.from_numpy(distance[:, 1:]).to(mean.dtype) ** 2)  # column 0 is itself
    difference = step[torch.from_numpy(index[:, 1:])] - step[:, None]
    # A square root at exactly 0 has an infinite slope, and unrotated Gaussians all have velocity 0.
    speed = torch.sqrt((difference**2).sum(dim=2) + 1e-20)
    return (weight * speed).mean()


def add_rigid_gradient(
    gradients: Gradients, model: Model, time: float, duration: float, weight: float, threads: int
) -> float:
    """Add weight × ∂(rigid loss)/∂parameters into `gradients`; returns weight × loss."""
    names = ("mean", "log_scale", "quat_left", "quat_right")
    rendered = model.gaussians().tensors()
    leaves = {name: rendered[name].detach().requires_grad_() for name in names}
    with torch.enable_grad():
        loss = weight * rigid_loss(*leaves.values(), time, duration, threads)
    if not loss.requires_grad:
        return 0.0
    for name, grad in zip(names, torch.autograd.grad(loss, list(leaves.values()), allow_unused=True)):
        if grad is not None:
            getattr(gradients, name).add_(grad)
    return loss.item()
