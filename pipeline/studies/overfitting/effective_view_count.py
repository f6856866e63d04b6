"""The effective number of training views that constrain each Gaussian.

Where one moving camera films the scene, a Gaussian that lives for a frame contributes to a single image. Its depth,
velocity and view-dependent colour are unconstrained: it overfits that image and degrades other views.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from datasets.scene import Scene
from pipeline.config.schema import Config
from pipeline.data.training_views import camera_at
from pipeline.model.model import Model
from rasterizer import Gradients, Rasterizer, Request


def effective_view_count(model: Model, scene: Scene, cfg: Config, threads: int) -> Tensor:
    """(N,) (Σ w)² / Σ w² over the training views; w is the sum of a Gaussian's blending weights α' T over a view.

    It is 1 where one view has all the weight, V where V views have equal weights, and 0 where no view has any. The
    derivative of the sum of all pixels by a Gaussian's colour is w: one backward pass a view gives all of them. All
    Gaussians are rendered grey, as a black one's colour is clamped at zero and would have no derivative.
    """
    rasterizer, first, second = Rasterizer(threads=threads), torch.zeros(len(model)), torch.zeros(len(model))
    grey = replace(model.gaussians(), sh=torch.zeros(len(model), 1, 3))
    gradients = Gradients.zeros_like(grey)
    for view in scene.train:
        camera = camera_at(view.camera, cfg.train.resolution_scale)
        rasterizer.render(grey, Request(camera, view.time, scene.duration, near=cfg.scene.near * scene.unit))
        gradients.views.clear()
        statistics = rasterizer.backward(gradients, d_color=torch.ones(3, camera.height, camera.width))
        rows, weight = statistics.visible.long(), gradients.views[0].gradient[:, 0]
        first.index_add_(0, rows, weight)
        second.index_add_(0, rows, weight.square())
    return first.square() / second.clamp(min=torch.finfo(second.dtype).tiny)
