"""Renders a model from a camera at a time, with the background and units of its scene; and how fast that is."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace

import numpy as np
import torch
from torch import Tensor

from datasets.scene import Scene
from pipeline.config.schema import Config
from pipeline.data.training_views import camera_at, evenly_spaced
from pipeline.evaluation.image_metrics import Geometry
from pipeline.model.model import Model
from pipeline.model.render import render_image
from rasterizer import Camera, Engine, Rasterizer, Request, engine_for

SMALLEST_ALPHA = 1e-6  # divisor of sums over no Gaussian, which are 0
SPEED_VIEWS = 30  # whose speed is measured, at most, evenly spread: the views of a video are similar


@dataclass(frozen=True)
class Renderer:
    """`model` with the duration, background and near plane of `scene`."""

    model: Model
    scene: Scene
    cfg: Config
    rasterizer: Engine
    _shown: Model = field(init=False, repr=False)  # the model on the engine's device

    def __post_init__(self) -> None:
        object.__setattr__(self, "_shown", self.model.to(self.rasterizer.device))

    def tensor(self, camera: Camera, time: float) -> Tensor:
        """(3, H, W), not clamped, on the engine's device. time: in the scene's unit."""
        return render_image(self.rasterizer, self._shown, self._request(camera, time))

    def image(self, camera: Camera, time: float) -> np.ndarray:
        """(H, W, 3) float32, clamped to [0, 1], not rounded to 8 bits."""
        return np.clip(self.tensor(camera, time).cpu().numpy().transpose(1, 2, 0), 0.0, 1.0)

    def geometry(self, camera: Camera, time: float, flow_dt: float | None) -> Geometry:
        """Depth and, with `flow_dt` (the scene's unit), flow of the Gaussians, without an environment map."""
        outputs = ("alpha", "depth") if flow_dt is None else ("alpha", "depth", "flow")
        request = replace(self._request(camera, time), outputs=outputs, flow_dt=flow_dt)
        out = self.rasterizer.render(self._shown.gaussians(), request, differentiable=False)
        assert out.alpha is not None and out.depth is not None
        alpha = out.alpha.clamp_min(SMALLEST_ALPHA)
        flow = None if out.flow is None else (out.flow / alpha).cpu().numpy()
        return Geometry((out.depth / alpha).cpu().numpy()[0], flow)

    def time_maps(self, camera: Camera, time: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(mean of μt, mean of Σtt, alpha), (H, W) each, over the Gaussians at a pixel; units of time, and squared.

        ValueError for a static model.
        """
        request = replace(self._request(camera, time), outputs=("alpha", "stats"))
        out = self.rasterizer.render(self._shown.gaussians(), request, differentiable=False)
        assert out.alpha is not None and out.stats is not None
        mean, variance = (out.stats / out.alpha.clamp_min(SMALLEST_ALPHA)).cpu().numpy()
        return mean, variance, out.alpha.cpu().numpy()[0]

    def _request(self, camera: Camera, time: float) -> Request:
        near = self.cfg.scene.near * self.scene.unit
        return Request(camera, time, self.scene.duration, background=self.scene.background, near=near)


def frames_per_second(model: Model, scene: Scene, cfg: Config, threads: int) -> tuple[float, float | None]:
    """(fps_render, fps_raster) over SPEED_VIEWS test views: the fastest of `evaluate.speed_repeats` passes each.

    fps_render: from the 4D Gaussians to the image, including slicing, projection, sorting, binning, blending and the
    environment map; a GPU's image stays there. fps_raster: blending alone, by the kernel's own clock; a GPU has none.
    """
    renderer, scale = Renderer(model, scene, cfg, engine_for(cfg.backend, threads)), cfg.train.resolution_scale
    views = [scene.test[index] for index in evenly_spaced(len(scene.test), SPEED_VIEWS)]
    shots = [(camera_at(view.camera, scale), view.time) for view in views]
    kernel = renderer.rasterizer if isinstance(renderer.rasterizer, Rasterizer) else None
    whole, blend = [], []
    for _ in range(cfg.evaluate.speed_repeats):
        blending = 0.0
        started = time.perf_counter()
        for camera, moment in shots:
            renderer.tensor(camera, moment)
            blending += 0.0 if kernel is None else kernel.stage_ms["blend"] / 1000.0
        if renderer.rasterizer.device.type == "cuda":
            torch.cuda.synchronize()
        whole.append(time.perf_counter() - started)
        blend.append(blending)
    raster = None if kernel is None else len(shots) / max(min(blend), 1e-9)
    return len(shots) / min(whole), raster
