"""Error in moving and in static pixels, where the test views come from one static camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_dilation

from datasets.scene import View
from pipeline.data.training_views import target_of
from pipeline.evaluation.renderer import Renderer
from pipeline.studies.open_run import TrainedRun
from rasterizer import Rasterizer

CHANGE = 0.03  # of full scale (8 grey levels): a moving pixel once differs by more from its median, in any channel
DILATION = 2  # pixels around them that count as moving too: objects rendered in the wrong place


@dataclass(frozen=True)
class ErrorByMotion:
    """The squared error of all test views, by pixel."""

    moving_fraction: float  # of the pixels
    moving_error: float  # fraction of the squared error that is in moving pixels
    moving_psnr: float  # dB, of the mean squared error over moving pixels of all views
    static_psnr: float  # dB, likewise over the other pixels


def error_by_motion(run: TrainedRun) -> ErrorByMotion | None:
    """None where the test camera moves, and where no pixel or every pixel is moving."""
    if not is_static_camera(run.scene.test):
        return None
    renderer = Renderer(run.model, run.scene, run.cfg, Rasterizer())
    targets = [target_of(view, run.cfg.train.resolution_scale) for view in run.scene.test]
    truth = np.stack([target.image.numpy().transpose(1, 2, 0) for target in targets])
    rendered = np.stack([renderer.image(target.camera, target.time) for target in targets])
    return split_error(truth, rendered)


def split_error(truth: np.ndarray, rendered: np.ndarray) -> ErrorByMotion | None:
    """(V, H, W, 3) images in [0, 1]. None where no pixel or every pixel is moving."""
    moving = moving_pixels(truth)
    if not moving.any() or moving.all():
        return None
    squared = ((rendered - truth) ** 2).mean(axis=(0, 3), dtype=np.float64)  # (H, W)
    with np.errstate(divide="ignore", invalid="ignore"):  # a perfect model: 0 / 0 is nan, PSNR is inf
        return ErrorByMotion(
            float(moving.mean()),
            float(squared[moving].sum() / squared.sum()),
            *(float(-10 * np.log10(squared[mask].mean())) for mask in (moving, ~moving)),
        )


def moving_pixels(images: np.ndarray) -> np.ndarray:
    """(H, W) bool mask of (V, H, W, 3) images in [0, 1] by one camera."""
    change = np.abs(images - np.median(images, axis=0)).max(axis=(0, 3))
    return binary_dilation(change > CHANGE, np.ones((2 * DILATION + 1,) * 2))


def is_static_camera(views: tuple[View, ...]) -> bool:
    """Whether all views have one pose and one image size."""
    first = views[0].camera
    return all(
        view.camera.width == first.width
        and view.camera.height == first.height
        and np.array_equal(view.camera.world_to_cam, first.world_to_cam)
        for view in views
    )
