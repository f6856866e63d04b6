"""Evaluation in about the time of rendering: PSNR, SSIM and loss, for use during training and validation."""

from __future__ import annotations

import numpy as np

from datasets.scene import Scene
from pipeline.config.schema import Config
from pipeline.data.training_views import Target, evenly_spaced, target_of
from pipeline.evaluation.image_metrics import masked_psnr, psnr
from pipeline.evaluation.metrics import mean
from pipeline.evaluation.moving_pixels import MovingPixels
from pipeline.evaluation.renderer import Renderer
from pipeline.model.model import Model
from rasterizer import Engine, engine_for
from rasterizer.loss import PhotometricLoss

EVAL_VIEWS = 30  # held-out views of an evaluation during training; the final one takes all


def quick_evaluate(
    model: Model, scene: Scene, cfg: Config, rasterizer: Engine, moving: MovingPixels | None = None
) -> dict[str, float | None]:
    """{psnr, ssim, test_loss, psnr_moving} over at most EVAL_VIEWS evenly spread test views. PSNR is that of the valid
    pixels, as in `held_out_psnr`.

    Renders have the final resolution, also while training is at a coarser one, so that the numbers of a run can be
    compared. SSIM is the loss's (zero padding at the border, as 3DGS), which differs from metrics.ssim in the third
    decimal. moving: of this scene, to be kept between evaluations; None: made here.
    """
    moving = moving or MovingPixels(scene, cfg.train.resolution_scale)
    renderer = Renderer(model, scene, cfg, rasterizer)
    criterion = PhotometricLoss(mse_weight=cfg.train.mse_weight, threads=rasterizer.threads)
    rows: list[dict[str, float | None]] = []
    for index in evenly_spaced(len(scene.test), EVAL_VIEWS):
        target = target_of(scene.test[index], cfg.train.resolution_scale)
        image = renderer.tensor(target.camera, target.time).clamp_(0.0, 1.0)
        loss = criterion(image, target.image.to(image.device))
        render, truth = (pixels.cpu().numpy().transpose(1, 2, 0) for pixels in (image, target.image))
        rows.append({
            "psnr": valid_psnr(render, truth, target), "ssim": loss.ssim, "test_loss": loss.loss,
            "psnr_moving": masked_psnr(render, truth, moving.of(index)),
        })  # fmt: skip
    found = {name: mean(rows, name) for name in ("psnr", "ssim", "test_loss")}
    return {**found, "psnr_moving": mean(rows, "psnr_moving", partial=True)}


def held_out_psnr(model: Model, scene: Scene, cfg: Config, threads: int) -> np.ndarray:
    """(test views,) PSNR in dB at the final resolution over the valid pixels: psnr_masked of metrics.json where a
    view's mask leaves pixels out, unless it leaves none, psnr elsewhere."""
    renderer, found = Renderer(model, scene, cfg, engine_for(cfg.backend, threads)), []
    for view in scene.test:
        target = target_of(view, cfg.train.resolution_scale)
        image, truth = renderer.image(target.camera, target.time), target.image.numpy().transpose(1, 2, 0)
        found.append(valid_psnr(image, truth, target))
    return np.array(found)


def valid_psnr(image: np.ndarray, truth: np.ndarray, target: Target) -> float:
    """PSNR in dB of (H, W, 3) images over the pixels inside the view's mask; over all if there are none."""
    valid = masked_psnr(image, truth, None if target.mask is None else target.mask.numpy())
    return psnr(image, truth) if valid is None else valid
