"""The share of the error that is in moving pixels, where these are known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.data.training_views import target_of
from pipeline.evaluation.motion.moving_pixels import MovingPixels
from pipeline.evaluation.renderer import Renderer
from pipeline.trained.open_run import TrainedRun
from rasterizer import Rasterizer


@dataclass(frozen=True)
class ErrorByMotion:
    """The squared error of all test views together; metrics.json has means over the views."""

    moving_fraction: float  # of the pixels
    moving_error: float  # fraction of the squared error that is in moving pixels
    moving_psnr: float  # dB, of the mean squared error over moving pixels of all views
    static_psnr: float  # dB, likewise over the other pixels


def error_by_motion(run: TrainedRun) -> ErrorByMotion | None:
    """None where moving pixels are unknown (evaluation/motion/moving_pixels.py), and where none or all are moving."""
    scale = run.cfg.train.resolution_scale
    masks = MovingPixels(run.scene, scale)
    moving = [mask for index in range(len(run.scene.test)) if (mask := masks.of(index)) is not None]
    if len(moving) < len(run.scene.test):
        return None
    renderer = Renderer(run.model, run.scene, run.cfg, Rasterizer())
    targets = [target_of(view, scale) for view in run.scene.test]
    truth = np.stack([target.image.numpy().transpose(1, 2, 0) for target in targets])
    rendered = np.stack([renderer.image(target.camera, target.time) for target in targets])
    return split_error(truth, rendered, np.stack(moving))


def split_error(truth: np.ndarray, rendered: np.ndarray, moving: np.ndarray) -> ErrorByMotion | None:
    """(V, H, W, 3) images in [0, 1] and (V, H, W) bool. None where no pixel or every pixel is moving."""
    if not moving.any() or moving.all():
        return None
    squared = ((rendered - truth) ** 2).mean(axis=3, dtype=np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):  # a perfect model: 0 / 0 is nan, PSNR is inf
        return ErrorByMotion(
            float(moving.mean()),
            float(squared[moving].sum() / squared.sum()),
            *(float(-10 * np.log10(squared[mask].mean())) for mask in (moving, ~moving)),
        )
