"""Regularization towards a simpler model: static and transparent Gaussians.

A monocular scene has one view per time: a Gaussian that is visible in one frame only is constrained by one camera, and
its depth and velocity are arbitrary. An infinite `motion` weight is no_4drot. Neither term is in the paper.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from datasets.scene import Scene
from pipeline.config.train_schema import RegularizationConfig
from pipeline.data.covered_share import covered_share
from pipeline.model.model import Model
from pipeline.model.tilt import UNTILTED
from rasterizer import Gradients

TILT_SOFTENING = 1e-3  # radians: smooths the norm at zero tilt


def relative_to_data(cfg: RegularizationConfig, scene: Scene) -> RegularizationConfig:
    """`cfg` with its weights on motion and opacity in proportion to what the training views determine.

    The photometric loss is a mean over all pixels and over the views. Pixels of the background's colour add nothing to
    it: where the scene covers a tenth of the images, a Gaussian's share of the loss is a tenth. The weights are
    multiplied by the covered share, and by reference_views / number of training views unless reference_views is 0.
    """
    if cfg.motion == cfg.opacity == 0:
        return cfg  # without reading the images
    factor = covered_share(scene.train, scene.background)
    if cfg.reference_views > 0:
        factor *= cfg.reference_views / len(scene.train)
    return replace(cfg, motion=cfg.motion * factor, opacity=cfg.opacity * factor)


def add_regularization_gradients(gradients: Gradients, model: Model, cfg: RegularizationConfig, scene: Scene) -> None:
    """Add ∂/∂parameters of the terms on motion and opacity to `gradients`, in place."""
    p, share = model.parameters, 1.0 / len(model)
    if cfg.motion > 0 and model.kind.motion == "velocity":
        assert gradients.velocity is not None
        gradients.velocity.add_(speed_gradient(p["velocity"]), alpha=cfg.motion * share)
    if cfg.motion > 0 and model.kind.motion == "full":
        left, right = tilt_gradient(p["quat_left"], p["quat_right"])
        gradients.quat_left.add_(left, alpha=cfg.motion * share)
        assert gradients.quat_right is not None
        gradients.quat_right.add_(right, alpha=cfg.motion * share)
    if cfg.opacity > 0:
        opacity = torch.sigmoid(p["opacity_logit"])
        gradients.opacity_logit.addcmul_(
            opacity * opacity_weight(model, cfg, scene), 1 - opacity, value=cfg.opacity * share
        )


def opacity_weight(model: Model, cfg: RegularizationConfig, scene: Scene) -> Tensor | float:
    """(N,), or one number for all, in (0, 1]: opacity_views / number of training views within one st, at most 1.

    It is 1 if opacity_views is 0, and for dynamic scenes with several cameras. There the cap on the number of Gaussians
    binds and the opacity term distributes it (synthetic/counter at 160 px: 27.91 dB with weight 1, 27.24 dB without the
    term). The weight has no gradient.
    """
    views = len(scene.train)
    if cfg.opacity_views == 0:
        return 1.0
    if model.kind.dims == 3:
        return min(1.0, cfg.opacity_views / views)
    if scene.several_cameras:
        return 1.0
    views_in_lifetime = torch.exp(model.parameters["log_scale"][:, 3]).mul_(views / scene.duration)
    return (cfg.opacity_views / views_in_lifetime).clamp_(max=1.0)


def speed_gradient(velocity: Tensor) -> Tensor:
    """∂ Σ 2 sin(θ/2) / ∂velocity, (N, 3), with the angle θ = arctan √(|v|² + ε²) of the path to the time axis."""
    speed = torch.sqrt((velocity * velocity).sum(dim=1, keepdim=True) + TILT_SOFTENING**2)
    return velocity / speed * torch.cos(0.5 * torch.atan(speed)) / (1 + speed * speed)


def tilt_gradient(quat_left: Tensor, quat_right: Tensor) -> tuple[Tensor, Tensor]:
    """∂ Σ √(tilt² + ε²) / ∂(quat_left, quat_right), (N, 4) each.

    With the unit vectors r = qr/|qr| and l = ql/|ql| without its tilt, c = r · l and w = √(|r - l|² + ε²), the
    gradients are (c r - l) / (|qr| w) and, of the untilted ql, (c l - r) / (|ql| w). Autograd takes 2.6 times as long.
    """
    norm_left, norm_right = quat_left.norm(dim=1, keepdim=True), quat_right.norm(dim=1, keepdim=True)
    left, right = quat_left / norm_left * UNTILTED.to(quat_left.dtype), quat_right / norm_right
    cosine = (left * right).sum(dim=1, keepdim=True)
    length = torch.sqrt((right - left).square_().sum(dim=1, keepdim=True) + TILT_SOFTENING**2)
    of_left = torch.addcmul(right.neg(), cosine, left).div_(norm_left * length).mul_(UNTILTED.to(quat_left.dtype))
    of_right = torch.addcmul(left.neg(), cosine, right).div_(norm_right * length)
    return of_left, of_right
