"""The losses on the parameters of the model: neighbours that move alike, transparency. None is in the paper.

A monocular scene has one view per time: a Gaussian that is visible in one frame only is constrained by one camera, and
its depth and velocity are arbitrary.

To add one, write its term, enter it in `model_terms`, and give its weight a key in pipeline/config/train_schema.py.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from scipy.spatial import cKDTree
from torch import Tensor

from datasets.scene import Scene
from pipeline.config.train_schema import RegularizationConfig
from pipeline.data.covered_share import covered_share
from pipeline.model.model import Model
from pipeline.training.objective.rigid_neighbours import RigidNeighbours
from pipeline.training.objective.terms import DrawnView, ModelTerm
from rasterizer import Gradients
from rasterizer.covariance import rotation_4d, time_row

NEIGHBOURS = 8  # nearest Gaussians that a Gaussian is compared with
RELEASED_NEIGHBOURS = 20  # the same in the released form
RIGID_EVERY = 32  # `rigid_loss` is that of every such training view, × this, for run time; the release's of every step
FALLOFF = 100.0  # weight exp(-100 d²), d in world units: 1/e at 0.1; the release's exp(-100 d)
MIN_MARGINAL = 0.7  # only Gaussians with temporal marginal p(t) above this
# Velocities are displacements per this fraction of the duration; the release uses 0.1 with D-NeRF's duration of 1.
VELOCITY_STEP = 0.1
OPACITY_VIEWS = 10.0  # opacity counts less where more training views than this are within one st

# That the rigid loss depends on; a model has one of the last two, and without 4D rotation neither.
FIELDS = ("mean", "log_scale", "quat_left", "quat_right", "velocity")


@dataclass(frozen=True)
class Rigid:
    """`weight` × `rigid_loss` at the time of the view. Only models with 4D rotation or velocities have it."""

    weight: float
    duration: float  # of the scene
    threads: int

    def add(self, gradients: Gradients, model: Model, view: DrawnView) -> float:
        if not model.kind.moves or view.number % RIGID_EVERY != 0:
            return 0.0
        weight = self.weight * RIGID_EVERY / view.batch  # as much as in every view
        time, shared = view.target.time, None
        if (of := model.trajectories) is not None:
            along = torch.cat([of.values(time)[:, :3], of.drift(time, 0)], dim=1)
            shared = model.parameters["weights"] @ along
        return view.batch * add_gradient(
            gradients,
            model,
            lambda fields: weight * rigid_loss(fields, time, self.duration, NEIGHBOURS, self.threads, shared),
        )


@dataclass(frozen=True)
class ReleasedRigid:
    """`weight` × `released_rigid_loss`, once in a batch, because it is the same for all views."""

    weight: float
    duration: float
    threads: int

    def add(self, gradients: Gradients, model: Model, view: DrawnView) -> float:
        if not model.kind.moves or view.place != 0:
            return 0.0
        return view.batch * add_gradient(
            gradients,
            model,
            lambda fields: self.weight * released_rigid_loss(fields, self.duration, RELEASED_NEIGHBOURS, self.threads),
        )


@dataclass(frozen=True)
class Transparency:
    """`weight` × the mean opacity, weighted by `opacity_weight`. Gradient alone."""

    weight: float
    scene: Scene

    def add(self, gradients: Gradients, model: Model, view: DrawnView) -> float:
        if view.place != view.batch - 1:
            return 0.0
        opacity = torch.sigmoid(model.parameters["opacity_logit"])
        gradients.opacity_logit.addcmul_(
            opacity * opacity_weight(model, self.scene), 1 - opacity, value=self.weight * (1.0 / len(model))
        )
        return 0.0


def model_terms(
    rules: RegularizationConfig, shared_motion: bool, scene: Scene, threads: int, seed: int
) -> list[ModelTerm]:
    """The losses of a schedule, in the order in which their gradients are added. rules: of `relative_to_data`."""
    terms: list[ModelTerm] = [
        RigidNeighbours(rules.rigid, scene, seed)
        if shared_motion
        else (ReleasedRigid if rules.rigid_released else Rigid)(rules.rigid, scene.duration, threads),
        Transparency(rules.opacity, scene),
    ]
    return [term for term in terms if term.weight > 0]


def relative_to_data(rules: RegularizationConfig, scene: Scene) -> RegularizationConfig:
    """`rules` with its weight on opacity in proportion to what the training views determine.

    The photometric loss is a mean over all pixels and over the views. Pixels of the background's colour add nothing to
    it: where the scene covers a tenth of the images, a Gaussian's share of the loss is a tenth. The weight is
    multiplied by the covered share, and by reference_views / number of training views unless reference_views is 0.
    """
    if rules.opacity == 0:
        return rules  # without reading the images
    factor = covered_share(scene.train, scene.background)
    if rules.reference_views > 0:
        factor *= rules.reference_views / len(scene.train)
    return replace(rules, opacity=rules.opacity * factor)


def add_gradient(gradients: Gradients, model: Model, loss_of: Callable[[dict[str, Tensor]], Tensor]) -> float:
    """Add ∂`loss_of`/∂parameters to `gradients`, in place, by autograd; returns the loss.

    loss_of: a scalar of the parameters among FIELDS.
    """
    leaves = {name: p.detach().requires_grad_() for name, p in model.parameters.items() if name in FIELDS}
    with torch.enable_grad():
        loss = loss_of(leaves)
    if not loss.requires_grad:
        return 0.0
    for name, grad in zip(leaves, torch.autograd.grad(loss, list(leaves.values()), allow_unused=True)):
        if grad is not None:
            getattr(gradients, name).add_(grad)
    return loss.item()


# ---- The rigid loss: differences between the velocities of neighbouring Gaussians -----------------------------


def rigid_loss(
    fields: dict[str, Tensor],
    time: float,
    duration: float,
    neighbours: int,
    threads: int = 1,
    shared: Tensor | None = None,
) -> Tensor:
    """Ours: the mean of exp(-100 d²) |u_i - u_j| over the Gaussians i with p(t) > MIN_MARGINAL and their neighbours j.

    u = Σ_xyz,t / Σtt × 0.1 duration is the displacement of the conditional mean in a tenth of the duration
    (docs/method.md 1.1). d is the distance at `time`, constant in the gradient. fields: the parameters among FIELDS.
    shared: (N, 6) displacement and velocity along shared trajectories at `time`, beside their own.
    """
    moving = _moving_at(fields, time)
    fields = {name: tensor[moving] for name, tensor in fields.items()}
    mean = fields["mean"]
    if len(mean) < 2:
        return mean.new_zeros(())
    velocity = _velocity(fields)
    position = mean[:, :3] + velocity * (time - mean[:, 3:])
    if shared is not None:
        position, velocity = position + shared[moving, :3], velocity + shared[moving, 3:]
    distance, index = _nearest(position, min(neighbours, len(mean) - 1), threads)
    return (torch.exp(-FALLOFF * distance**2) * _relative_speeds(velocity, index, duration)).mean()


def released_rigid_loss(fields: dict[str, Tensor], duration: float, neighbours: int, threads: int = 1) -> Tensor:
    """That of the released program (commit 63725f2), which uses it on one scene, D-NeRF's lego.

    Sum of exp(-100 d) |u_i - u_j| / (N k) over all N Gaussians i and the k = `neighbours` means nearest to μ_i, of
    which μ_i is one. u and the rest as in `rigid_loss`."""
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


# ---- Opacity -----------------------------------------------------------------------------------------


def opacity_weight(model: Model, scene: Scene) -> Tensor | float:
    """(N,), or one number for all, in (0, 1]: OPACITY_VIEWS / number of training views within one st, at most 1.

    It is 1 for dynamic scenes with several cameras. There the cap on the number of Gaussians
    binds and the opacity term distributes it (synthetic/counter at 160 px: 27.91 dB with weight 1, 27.24 dB without the
    term). The weight has no gradient.
    """
    views = len(scene.train)
    if model.kind.dims == 3:
        return min(1.0, OPACITY_VIEWS / views)
    if scene.several_cameras:
        return 1.0
    views_in_scale = torch.exp(model.parameters["log_scale"][:, 3]).mul_(views / scene.duration)
    return (OPACITY_VIEWS / views_in_scale).clamp_(max=1.0)
