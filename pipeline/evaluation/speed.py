"""Rendering speed of a model on held-out views, in frames per second."""

from __future__ import annotations

import time

from datasets.scene import Scene
from pipeline.config.schema import Config
from pipeline.data.training_views import camera_at, evenly_spaced
from pipeline.evaluation.renderer import Renderer
from pipeline.model.model import Model
from rasterizer import Rasterizer

SPEED_VIEWS = 30  # at most, evenly spread: the views of a video are similar


def frames_per_second(model: Model, scene: Scene, cfg: Config, threads: int) -> dict[str, float]:
    """{fps_render, fps_raster} over SPEED_VIEWS test views: the fastest of `evaluate.speed_repeats` passes each.

    fps_render: from the 4D Gaussians to the image, including slicing, projection, sorting, binning, blending and the
    environment map. fps_raster: blending alone, by the kernel's own clock.
    """
    renderer, scale = Renderer(model, scene, cfg, Rasterizer(threads=threads)), cfg.train.resolution_scale
    views = [scene.test[index] for index in evenly_spaced(len(scene.test), SPEED_VIEWS)]
    shots = [(camera_at(view.camera, scale), view.time) for view in views]
    whole, blend = [], []
    for _ in range(cfg.evaluate.speed_repeats):
        blending = 0.0
        started = time.perf_counter()
        for camera, moment in shots:
            renderer.tensor(camera, moment)
            blending += renderer.rasterizer.stage_ms["blend"] / 1000.0
        whole.append(time.perf_counter() - started)
        blend.append(blending)
    return {"fps_raster": len(shots) / max(min(blend), 1e-9), "fps_render": len(shots) / min(whole)}
