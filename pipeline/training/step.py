"""The views of one iteration, one after another: render, compare, carry the gradient back (docs/method.md 2)."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from datasets.composition import Color
from datasets.scene import Scene
from pipeline.config.schema import Config
from pipeline.data.training_views import Target
from pipeline.model.model import Model
from pipeline.model.render import backward, render
from pipeline.training.objective.losses import view_loss
from pipeline.training.schedule import Phase
from rasterizer import Frame, Gradients, Request, ViewGradient
from rasterizer.loss import L1Ssim


@dataclass(frozen=True)
class ViewStep:
    """What the forward and backward pass of one view say."""

    loss: float
    image: Tensor  # (3, H, W)
    target: Tensor  # (3, H, W) what it was compared with
    gradient: ViewGradient  # of the batch's loss


class Kernels:
    """The compiled parts with their scratch memory, reused from view to view."""

    def __init__(self, ssim_weight: float, threads: int) -> None:
        self.frame = Frame(threads=threads)
        self.criterion = L1Ssim(ssim_weight, threads)
        self.threads = threads


class Batch:
    """What `backward` of each view adds up to."""

    def __init__(self, model: Model, scene: Scene, cfg: Config, kernels: Kernels, phase: Phase, size: int) -> None:
        self._model, self._scene, self._cfg, self._kernels = model, scene, cfg, kernels
        self._phase, self._size = phase, size
        sparse = cfg.train.optimiser == "sparse_adam"
        self.touched = torch.zeros(len(model), dtype=torch.uint8) if sparse else None
        trained = model.environment is not None and phase.environment
        self.d_environment = torch.zeros_like(model.environment.image) if trained else None  # of the batch's loss
        self.loss = 0.0  # mean over the batch, once all views are through
        self.n_gaussians = len(model)  # densification after the batch may change how many there are
        self.alive = 0.0  # of them those with p(t) >= 0.05 a view, likewise

    def backward(self, target: Target, background: Color, gradients: Gradients) -> ViewStep:
        """Render `target` over `background`, which its image is composed over, and add the gradient of its share of the
        batch's loss into `gradients`."""
        scene, cfg, frame = self._scene, self._cfg, self._kernels.frame
        request = Request(
            target.camera,
            target.time,
            scene.duration,
            background,
            near=cfg.scene.near * scene.unit,
            sh_degree=self._phase.sh_degree,
            fourier_order=self._phase.fourier_order,
        )
        rendered = render(frame, self._model, request)
        found = view_loss(self._kernels.criterion, rendered.image, target.image, self._size)
        seen = backward(frame, self._model, rendered, found.d_image, gradients, self.d_environment)
        loss = found.loss
        if cfg.train.rigid_weight > 0 and self._model.kind.motion == "full":
            from pipeline.training.objective.rigid_loss import (
                add_rigid_gradient,  # only where a configuration asks for it
            )

            loss += self._size * add_rigid_gradient(
                gradients,
                self._model,
                target.time,
                scene.duration,
                cfg.train.rigid_weight / self._size,
                self._kernels.threads,
            )
        if self.touched is not None:
            seen.mark(self.touched, self._kernels.threads)
        self.loss += loss / self._size
        self.alive += frame.alive / self._size
        return ViewStep(loss, rendered.image, target.image, seen)

    def gradients_of(self, target: Target, background: Color) -> Gradients:
        """The gradient of one view alone, over the background it was trained over: to find out which is broken."""
        alone = Gradients.zeros_like(self._model.gaussians())
        self.backward(target, background, alone)
        return alone
