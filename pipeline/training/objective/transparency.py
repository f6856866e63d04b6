"""The loss on opacity: Gaussians that no image needs become transparent and are pruned."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from datasets.scene import Scene
from pipeline.config.train_schema import RegularizationConfig
from pipeline.data.covered_share import covered_share
from pipeline.model.model import Model
from pipeline.training.objective.terms import DrawnView
from rasterizer import Gradients

OPACITY_VIEWS = 10.0  # opacity counts less where more training views than this are within one st


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


def relative_to_data(rules: RegularizationConfig, scene: Scene) -> float:
    """The weight on opacity in proportion to what the training views determine.

    The photometric loss is a mean over all pixels and over the views. Pixels of the background's colour add nothing to
    it: where the scene covers a tenth of the images, a Gaussian's share of the loss is a tenth. The weight is
    multiplied by the covered share, and by reference_views / number of training views unless reference_views is 0.
    """
    if rules.opacity == 0:
        return 0.0  # without reading the images
    factor = covered_share(scene.train, scene.background)
    if rules.reference_views > 0:
        factor *= rules.reference_views / len(scene.train)
    return rules.opacity * factor


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
