"""What a Gaussian is worth: how much of the training images it makes."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from datasets.scene import Scene
from pipeline.config import Config
from pipeline.model import OF_THE_WHOLE, Model
from pipeline.views import camera_at
from rasterizer import Frame, Gradients, Request


def importance(model: Model, scene: Scene, cfg: Config, threads: int) -> Tensor:
    """(N,) Σ over training views and pixels of the Gaussian's blending weight w = α' T (SPEC 1).

    The derivative of a sum of pixels by a Gaussian's colour is the sum of its weights, so that one backward pass a
    view gives them all. All are shown in grey: a black one's colour is clamped at zero and would have no derivative,
    though it hides what is behind it.
    """
    frame, total = Frame(threads=threads), torch.zeros(len(model))
    grey = replace(model.gaussians(), sh=torch.zeros(len(model), 1, 3))
    gradients = Gradients.zeros_like(grey)
    for view in scene.train:
        camera = camera_at(view.camera, cfg.train.resolution_scale)
        frame.render(grey, Request(camera, view.time, scene.duration, near=cfg.scene.near * scene.unit))
        gradients.views.clear()
        seen = frame.backward(gradients, d_color=torch.ones(3, camera.height, camera.width))
        total.index_add_(0, seen.visible.long(), gradients.views[0].gradient[:, 0])
    return total


def keep_most_important(model: Model, worth: Tensor, fraction: float) -> Model:
    """The `fraction` (0 to 1) of the Gaussians that are worth most, at least one, in their order; ties by index."""
    count = max(1, round(fraction * len(model)))
    kept = torch.sort(worth, descending=True, stable=True).indices[:count].sort().values
    state = {name: tensor if name in OF_THE_WHOLE else tensor[kept] for name, tensor in model.state().items()}
    return Model.restored(model.kind, state)
