"""Where a model errs, on what moves or on what stands still: a held-out camera that stands still tells them apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_dilation

from datasets.scene import View
from pipeline.data.training_views import target_of
from pipeline.evaluation.evaluate import Renderer
from pipeline.studies.open_run import TrainedRun
from rasterizer import Rasterizer

CHANGE = 0.03  # of full scale: a pixel that is ever farther from its median, in any channel, moves; eight grey levels
WIDEN = 2  # pixels round those that count as moving too, for what is shown in the wrong place


@dataclass(frozen=True)
class ErrorByMotion:
    """The squared error of all test views, shared out."""

    moving: float  # part of the pixels that move
    error: float  # part of the squared error that is theirs
    moving_psnr: float  # dB, of the mean squared error over these pixels of all views
    still_psnr: float  # likewise over the others


def error_by_motion(run: TrainedRun) -> ErrorByMotion | None:
    """None where the test views' camera moves, or where nothing or everything in them does."""
    if not _one_place(run.scene.test):
        return None
    renderer = Renderer(run.model, run.scene, run.cfg, Rasterizer())
    targets = [target_of(view, run.cfg.train.resolution_scale) for view in run.scene.test]
    truth = np.stack([target.image.numpy().transpose(1, 2, 0) for target in targets])
    found = np.stack([renderer.image(target.camera, target.time) for target in targets])
    return shared_out(truth, found)


def shared_out(truth: np.ndarray, found: np.ndarray) -> ErrorByMotion | None:
    """(V, H, W, 3) each, in [0, 1]. None where nothing or everything moves."""
    mask = moving_pixels(truth)
    if not mask.any() or mask.all():
        return None
    squared = ((found - truth) ** 2).mean(axis=(0, 3), dtype=np.float64)  # (H, W)
    with np.errstate(divide="ignore", invalid="ignore"):  # a perfect model has no error to share: nan, and inf dB
        return ErrorByMotion(
            float(mask.mean()),
            float(squared[mask].sum() / squared.sum()),
            *(float(-10 * np.log10(squared[part].mean())) for part in (mask, ~mask)),
        )


def moving_pixels(images: np.ndarray) -> np.ndarray:
    """(H, W) bool, of (V, H, W, 3) images by one camera in [0, 1]."""
    change = np.abs(images - np.median(images, axis=0)).max(axis=(0, 3))
    return binary_dilation(change > CHANGE, np.ones((2 * WIDEN + 1,) * 2))


def _one_place(views: tuple[View, ...]) -> bool:
    first = views[0].camera
    return all(
        view.camera.width == first.width
        and view.camera.height == first.height
        and np.array_equal(view.camera.world_to_cam, first.world_to_cam)
        for view in views
    )
