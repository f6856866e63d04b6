"""Pulls towards the simpler model: each Gaussian stands still, lives long, is transparent and has one colour, unless the
images say otherwise.

A monocular scene shows each moment once, so that a Gaussian that lives for one frame is seen by one camera: it can
stand at any depth, move at any speed and have any colour from elsewhere. Each prior is the soft form of an ablation:
an infinite `motion` is no_4drot, an infinite `color` no_4dsh with a colour that is the same from everywhere, an
infinite `lifetime` a static scene. None is in the paper.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from datasets.scene import Scene
from pipeline.config.train_schema import RegularizationConfig
from pipeline.model.model import Model
from rasterizer import Gradients

TILT_SOFTENING = 1e-3  # radians: the norm's slope is smooth within this of standing still
DECAY_EVERY = 10  # iterations between decays of the coefficients, a pass over most of the model's bytes


def add_regularization_gradients(gradients: Gradients, model: Model, cfg: RegularizationConfig, scene: Scene) -> None:
    """Add ∂/∂parameters of the priors on motion, lifetime and opacity to `gradients`, in place."""
    p, share = model.parameters, 1.0 / len(model)
    if cfg.motion > 0 and model.kind.motion == "full":
        left, right = tilt_gradient(p["quat_left"], p["quat_right"])
        gradients.quat_left.add_(left, alpha=cfg.motion * share)
        gradients.quat_right.add_(right, alpha=cfg.motion * share)
    if cfg.lifetime > 0 and model.kind.dims == 4:
        short = torch.exp(-p["log_scale"][:, 3])
        gradients.log_scale[:, 3].sub_(short, alpha=cfg.lifetime * share * scene.frame_spacing)
    if cfg.opacity > 0:
        opacity = torch.sigmoid(p["opacity_logit"])
        gradients.opacity_logit.addcmul_(
            opacity * lack_of_views(model, cfg, scene), 1 - opacity, value=cfg.opacity * share
        )


def lack_of_views(model: Model, cfg: RegularizationConfig, scene: Scene) -> Tensor | float:
    """(N,) or one for all, in (0, 1]: opacity_views / training views within a standard deviation of the lifetime.

    1 where there are fewer, where opacity_views is 0, and where several cameras film what moves: there Gaussians are
    many for the cap, and the prior is what shares it out (synthetic/counter at 160 px: 27.91 dB with 1, 27.24 without).
    A function of st that the prior does not pull at.
    """
    views = len(scene.train)
    if cfg.opacity_views == 0:
        return 1.0
    if model.kind.dims == 3:
        return min(1.0, cfg.opacity_views / views)
    if views >= 2 * len(scene.train_times):
        return 1.0
    shared = torch.exp(model.parameters["log_scale"][:, 3]).mul_(views / scene.duration)
    return (cfg.opacity_views / shared).clamp_(max=1.0)


def tilt(quat_left: Tensor, quat_right: Tensor) -> Tensor:
    """(N,) how far the rotation turns the time axis into space: 2 sin(θ/2), θ the angle; (N, 4) quaternions.

    With v = (x, y, z, t) = x + yi + zj + tk rotated to ql v qr (docs/method.md 1), time stays time where ql k qr = k,
    that is where qr = (a, b, c, -d) for ql = (a, b, c, d), both of length 1. The tilt is the distance from that. A Gaussian
    far longer in time than in space moves at tan θ.
    """
    return _difference(quat_left, quat_right).norm(dim=1)


def tilt_gradient(quat_left: Tensor, quat_right: Tensor) -> tuple[Tensor, Tensor]:
    """∂ Σ √(tilt² + ε²) / ∂(quat_left, quat_right), (N, 4) each."""
    with torch.enable_grad():
        leaves = [q.detach().requires_grad_() for q in (quat_left, quat_right)]
        length = torch.sqrt(_difference(*leaves).square().sum(dim=1) + TILT_SOFTENING**2)
        return torch.autograd.grad(length.sum(), leaves)


def decay_colors(model: Model, strength: float, rate: float) -> None:
    """Shrink all coefficients but the constant one by strength × rate, decoupled from Adam's moments; in place.

    For DECAY_EVERY iterations at once. rate: the learning rate of these coefficients.
    """
    model.parameters["sh"][:, 1:].mul_((1.0 - min(1.0, strength * rate)) ** DECAY_EVERY)


def _difference(quat_left: Tensor, quat_right: Tensor) -> Tensor:
    still = F.normalize(quat_left, dim=1) * quat_left.new_tensor([1.0, 1.0, 1.0, -1.0])
    return F.normalize(quat_right, dim=1) - still
