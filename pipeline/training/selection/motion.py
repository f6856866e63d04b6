"""Static or dynamic, decided by validation: two short trainings, with and without time, on part of the training views.

A single camera sees every moment from one side only. Where little moves, or where what moves is seen too briefly, a
model with time fits that one side and is worse in between than a model without time. So both are trained in a part of
the schedule and at half resolution on three quarters of the training poses, and compared on the other quarter. Test
views are not used.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

from datasets.files.errors import SceneError
from datasets.scene import Scene
from datasets.validation import hold_out_poses
from pipeline.config.scene_overrides import with_overrides
from pipeline.config.schema import Config
from pipeline.data.sfm.photograph import Reconstruction
from pipeline.model.model import kind_of
from pipeline.model.scene_settings import resolved
from pipeline.training.selection.short_training import (
    MIN_STANDARD_ERRORS,
    VALIDATION_EVERY,
    mean_and_error,
    short_schedule,
    trained_psnr,
)
from pipeline.training.selection.time_colour import without_time_colour

FEWEST_VIEWS = 3  # of validation


@dataclass(frozen=True)
class MotionSelection:
    """Result of the validation."""

    static_psnr: float  # dB, mean over the validation views
    dynamic_psnr: float
    standard_error: float  # dB, of the difference
    views: int
    seconds: float  # of both trainings

    @property
    def dynamic(self) -> bool:
        """Whether time is kept: it must gain, and by more than chance."""
        return self.dynamic_psnr - self.static_psnr > MIN_STANDARD_ERRORS * self.standard_error

    def __str__(self) -> str:
        gain = self.dynamic_psnr - self.static_psnr
        return (
            f"{'dynamic' if self.dynamic else 'static'}: on {self.views} held-out frames a model with time has "
            f"{self.dynamic_psnr:.2f} dB, one without {self.static_psnr:.2f} ({gain:+.2f} ± {self.standard_error:.2f}"
            "); ablation.static=true or false decides otherwise"
        )


def due(cfg: Config, scene: Scene) -> bool:
    """Whether the schedule asks for it, and the scene is one moving camera whose model may have time. False with a time
    budget, all of which is for the schedule."""
    train = cfg.train
    if train.select_motion == 0 or train.time_budget_s is not None or cfg.ablation.static is not None:
        return False
    if kind_of(scene, cfg).motion == "static" or scene.several_cameras:
        return False
    poses = {view.camera.world_to_cam.tobytes() for view in scene.train}
    if len(poses) < len(scene.train):
        return False
    try:
        part = hold_out_poses(scene, VALIDATION_EVERY)
    except SceneError:
        return False
    return part.extent > 0 and len(part.test) >= FEWEST_VIEWS


def without_time(cfg: Config, scene: Scene) -> Config:
    """The configuration of the static model of the same scene. That of a clip has the overrides for clips, too, where
    those for static scenes do not replace them."""
    return resolved(replace(cfg, ablation=replace(cfg.ablation, static=True)), scene)


def select_motion(
    scene: Scene, cfg: Config, cloud: Reconstruction | None, threads: int, log: Callable[[str], None]
) -> MotionSelection:
    """Train twice on `scene.train`. Deterministic in scene, configuration and seed, except for the seconds."""
    started, part = time.perf_counter(), hold_out_poses(scene, VALIDATION_EVERY)
    psnr = []
    # With one schedule for both: the static overrides alone gain more in so short a training than motion does.
    cfg = with_overrides(cfg, None)
    for variant, label in ((without_time(cfg, scene), "without"), (without_time_colour(cfg), "with")):
        short = short_schedule(variant.train, cfg.train.select_motion)
        log(
            f"select_motion: {label} time, {short.iterations} iterations; {len(part.train)} training frames, "
            f"{len(part.test)} validation frames"
        )
        psnr.append(trained_psnr(part, replace(variant, train=short, resume=False), cloud, threads))
    static, dynamic = psnr
    _, error = mean_and_error(dynamic - static, [view.camera.world_to_cam.tobytes() for view in part.test])
    seconds = time.perf_counter() - started
    return MotionSelection(float(static.mean()), float(dynamic.mean()), error, len(part.test), seconds)
