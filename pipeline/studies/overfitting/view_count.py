"""From how many places each Gaussian was seen.

Where one camera moves, a Gaussian that lives for a frame is seen in one image. It can stand at any depth along the
ray, move at any speed and have any colour from elsewhere: it is that image learnt by heart, and other views pay for it.
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
    """(N,) (Σ w)² / Σ w² over the training views, w the sum of a Gaussian's blending weights α' T in one.

    The effective number of views: 1 if one has all, V if V have as much, 0 for what none has seen. The derivative of a
    sum of pixels by a Gaussian's colour is the sum of its weights, so that one backward pass a view gives them all. All
    are shown in grey: a black one's colour is clamped at zero and would have no derivative, though it hides what is
    behind it.
    """
    frame, first, second = Rasterizer(threads=threads), torch.zeros(len(model)), torch.zeros(len(model))
    grey = replace(model.gaussians(), sh=torch.zeros(len(model), 1, 3))
    gradients = Gradients.zeros_like(grey)
    for view in scene.train:
        camera = camera_at(view.camera, cfg.train.resolution_scale)
        frame.render(grey, Request(camera, view.time, scene.duration, near=cfg.scene.near * scene.unit))
        gradients.views.clear()
        seen = frame.backward(gradients, d_color=torch.ones(3, camera.height, camera.width))
        rows, weight = seen.visible.long(), gradients.views[0].gradient[:, 0]
        first.index_add_(0, rows, weight)
        second.index_add_(0, rows, weight.square())
    return first.square() / second.clamp(min=torch.finfo(second.dtype).tiny)
