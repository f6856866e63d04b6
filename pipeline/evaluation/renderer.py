"""Renders a model from a camera at a time, with the background and units of its scene."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from torch import Tensor

from datasets.scene import Scene
from pipeline.config.schema import Config
from pipeline.model.model import Model
from pipeline.model.render import render_image
from rasterizer import Camera, Rasterizer, Request


@dataclass(frozen=True)
class Renderer:
    """`model` with the duration, background and near plane of `scene`."""

    model: Model
    scene: Scene
    cfg: Config
    rasterizer: Rasterizer

    def tensor(self, camera: Camera, time: float) -> Tensor:
        """(3, H, W), not clamped. time: in the scene's unit."""
        near = self.cfg.scene.near * self.scene.unit
        request = Request(camera, time, self.scene.duration, background=self.scene.background, near=near)
        return render_image(self.rasterizer, self.model, request)

    def image(self, camera: Camera, time: float) -> np.ndarray:
        """(H, W, 3) float32, clamped to [0, 1], not rounded to 8 bits."""
        return np.clip(self.tensor(camera, time).numpy().transpose(1, 2, 0), 0.0, 1.0)
