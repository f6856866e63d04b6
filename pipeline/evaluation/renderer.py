"""Renders a model from a camera at a time, with the background and units of its scene."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from torch import Tensor

from datasets.scene import Scene
from pipeline.config.schema import Config
from pipeline.evaluation.image_metrics import Geometry
from pipeline.model.model import Model
from pipeline.model.render import render_image
from rasterizer import Camera, Rasterizer, Request

SMALLEST_ALPHA = 1e-6  # divisor of sums over no Gaussian, which are 0


@dataclass(frozen=True)
class Renderer:
    """`model` with the duration, background and near plane of `scene`."""

    model: Model
    scene: Scene
    cfg: Config
    rasterizer: Rasterizer

    def tensor(self, camera: Camera, time: float) -> Tensor:
        """(3, H, W), not clamped. time: in the scene's unit."""
        return render_image(self.rasterizer, self.model, self._request(camera, time))

    def image(self, camera: Camera, time: float) -> np.ndarray:
        """(H, W, 3) float32, clamped to [0, 1], not rounded to 8 bits."""
        return np.clip(self.tensor(camera, time).numpy().transpose(1, 2, 0), 0.0, 1.0)

    def geometry(self, camera: Camera, time: float, flow_dt: float | None) -> Geometry:
        """Depth and, with `flow_dt` (the scene's unit), flow of the Gaussians, without an environment map."""
        outputs = ("alpha", "depth") if flow_dt is None else ("alpha", "depth", "flow")
        request = replace(self._request(camera, time), outputs=outputs, flow_dt=flow_dt)
        out = self.rasterizer.render(self.model.gaussians(), request, differentiable=False)
        assert out.alpha is not None and out.depth is not None
        alpha = out.alpha.clamp_min(SMALLEST_ALPHA)
        flow = None if out.flow is None else (out.flow / alpha).numpy()
        return Geometry((out.depth / alpha).numpy()[0], flow)

    def time_maps(self, camera: Camera, time: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(mean of μt, mean of Σtt, alpha), (H, W) each, over the Gaussians at a pixel; units of time, and squared.

        ValueError for a static model.
        """
        request = replace(self._request(camera, time), outputs=("alpha", "stats"))
        out = self.rasterizer.render(self.model.gaussians(), request, differentiable=False)
        assert out.alpha is not None and out.stats is not None
        mean, variance = (out.stats / out.alpha.clamp_min(SMALLEST_ALPHA)).numpy()
        return mean, variance, out.alpha.numpy()[0]

    def _request(self, camera: Camera, time: float) -> Request:
        near = self.cfg.scene.near * self.scene.unit
        return Request(camera, time, self.scene.duration, background=self.scene.background, near=near)
