"""What a view is trained on differs at random from what it is: Gaussians left out, another time, another background.

All of it is drawn from a generator of the iteration's own, so that a resumed run draws the same.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch

from datasets.scene import Scene
from pipeline.model import Model
from pipeline.train_config import TrainConfig
from pipeline.views import Target
from rasterizer import Gaussians

OUT_OF_SIGHT = -80.0  # a logit whose opacity no pixel shows


@dataclass(frozen=True)
class Perturbed:
    """What one view renders and is compared with."""

    gaussians: Gaussians
    target: Target
    background: tuple[float, float, float]
    one_color: bool  # leave out all coefficients but the constant one


def perturbs(cfg: TrainConfig) -> bool:
    """Does this schedule ask for any of it?"""
    return cfg.dropout > 0 or cfg.color_dropout > 0 or cfg.time_jitter > 0 or cfg.random_background


def perturb(model: Model, target: Target, scene: Scene, cfg: TrainConfig, generator: np.random.Generator) -> Perturbed:
    """One draw for one view."""
    gaussians, background = model.gaussians(), scene.background
    if cfg.dropout > 0:
        out = torch.from_numpy(generator.random(len(model), dtype=np.float32) < cfg.dropout)
        gaussians = replace(gaussians, opacity_logit=gaussians.opacity_logit.masked_fill(out, OUT_OF_SIGHT))
    if cfg.time_jitter > 0:
        shift = cfg.time_jitter * scene.frame_spacing * generator.uniform(-1.0, 1.0)
        target = replace(target, time=target.time + shift)
    if cfg.random_background and target.alpha is not None:
        background = tuple(generator.random(3).tolist())
        change = torch.tensor(background) - torch.tensor(scene.background)
        target = replace(target, image=target.image + (1 - target.alpha) * change[:, None, None])
    one_color = cfg.color_dropout > 0 and generator.random() < cfg.color_dropout
    return Perturbed(gaussians, target, background, one_color)
