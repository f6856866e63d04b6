"""Selection of time-varying colour by validation: two short trainings, with and without, on part of the training views.

4DSH has two thirds of a Gaussian's parameters. Scenes whose colours change with time need it; in others it fits noise
and costs memory and time. So the model is trained with and without it, in a part of the schedule and at half
resolution, on three quarters of the training poses. The other quarter is the validation set. Test views are not used.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

from datasets.files.errors import SceneError
from datasets.scene import Scene
from datasets.validation import hold_out_poses
from pipeline.config.schema import Config
from pipeline.config.train_schema import TrainConfig
from pipeline.data.sfm.photograph import Reconstruction
from pipeline.model.model import kind_of
from pipeline.training.selection.short_training import VALIDATION_EVERY, mean_and_error, short_schedule, trained_psnr

# dB, and of the gain. To leave out colours that do change costs more than to keep coefficients that have no use.
MIN_GAIN, MIN_STANDARD_ERRORS = 0.1, 1.0
# Of the coefficients of time: in so few iterations they would hardly leave zero. 1 decides wrongly on one of two scenes
# with changing colours, 10 makes the model worse than one without (results/measured/motion/motion.md).
LEARNING_RATE_FACTOR = 3.0


@dataclass(frozen=True)
class Selection:
    """Result of the validation."""

    gain: float  # dB of PSNR by time-varying colour, mean over the validation views
    standard_error: float  # dB, of that mean
    views: int
    seconds: float  # of both trainings

    @property
    def kept(self) -> bool:
        return self.gain > max(MIN_GAIN, MIN_STANDARD_ERRORS * self.standard_error)

    def __str__(self) -> str:
        return (
            f"time-varying colour changes the PSNR of {self.views} validation views by {self.gain:+.2f} ± "
            f"{self.standard_error:.2f} dB: {'kept' if self.kept else 'left out'}"
        )


def due(cfg: Config, scene: Scene) -> bool:
    """Whether the schedule has a selection and the model time-varying colour. False with a time budget, all of which is
    for the schedule, and for scenes with too few poses or validation views."""
    train = cfg.train
    if train.select_time_colour == 0 or train.time_budget_s is not None or kind_of(scene, cfg).fourier_order == 0:
        return False
    try:
        part = hold_out_poses(scene, VALIDATION_EVERY)
    except SceneError:
        return False
    return part.extent > 0 and len(part.test) >= 2  # a single view has no standard error


def without_time_colour(cfg: Config) -> Config:
    """The configuration without time-varying colour: that of the ablation No-4DSH."""
    return replace(cfg, ablation=replace(cfg.ablation, fourier_order=0))


def select(
    scene: Scene, cfg: Config, cloud: Reconstruction | None, threads: int, log: Callable[[str], None]
) -> Selection:
    """Train twice on `scene.train`. Deterministic in scene, configuration and seed, except for the seconds."""
    started, part = time.perf_counter(), hold_out_poses(scene, VALIDATION_EVERY)
    short = _faster_time_colour(short_schedule(cfg.train, cfg.train.select_time_colour))
    cfg, psnr = replace(cfg, train=short, resume=False), []
    for variant, label in ((cfg, "with"), (without_time_colour(cfg), "without")):
        log(
            f"select_time_colour: {label} time-varying colour, {short.iterations} iterations; "
            f"{len(part.train)} training views, {len(part.test)} validation views"
        )
        psnr.append(trained_psnr(part, variant, cloud, threads))
    gain, error = mean_and_error(psnr[0] - psnr[1], [view.camera.world_to_cam.tobytes() for view in part.test])
    return Selection(gain, error, len(part.test), time.perf_counter() - started)


def _faster_time_colour(cfg: TrainConfig) -> TrainConfig:
    def faster(rate: float | None) -> float:
        return LEARNING_RATE_FACTOR * (cfg.lr.sh_rest if rate is None else rate)

    return replace(cfg, lr=replace(cfg.lr, sh_time=faster(cfg.lr.sh_time), sh_view_time=faster(cfg.lr.sh_view_time)))
