"""Selection of time-varying colour by validation: two short trainings, with and without, on part of the training views.

4DSH has two thirds of a Gaussian's parameters. Scenes whose colours change with time need it; in others it fits noise
and costs memory and time. So the model is trained with and without it, in a part of the schedule and at half
resolution, on three quarters of the training poses. The other quarter is the validation set. Test views are not used.
"""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from datasets.files.errors import SceneError
from datasets.scene import Scene
from datasets.validation import hold_out_poses
from pipeline.config.random_streams import Stream, stream
from pipeline.config.schema import Config
from pipeline.data.sfm.photograph import Reconstruction
from pipeline.evaluation.quick_evaluate import held_out_psnr
from pipeline.model.initialise import initialise
from pipeline.model.model import Model, kind_of
from pipeline.training import schedule
from pipeline.training.loop import Progress, train
from pipeline.training.run_log import temporary_run

VALIDATION_EVERY = 4  # every fourth pose is a validation pose
RESOLUTION = 0.5  # × the schedule's
# dB. Twice the standard deviation of the gain over seeds, which the standard error over views does not include.
MIN_GAIN = 0.2
MIN_STANDARD_ERRORS = 2.0  # of the gain, above zero


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
    short = schedule.shortened(cfg.train, cfg.train.select_time_colour)
    short = replace(
        short,
        resolution_scale=RESOLUTION * short.resolution_scale,
        eval_every=short.iterations,
        checkpoint_every=short.iterations,
        regularization=replace(short.regularization, flow=0.0),  # measuring it would take longer than the training
    )
    cfg, psnr = replace(cfg, train=short, resume=False), []
    for variant, label in ((cfg, "with"), (without_time_colour(cfg), "without")):
        log(
            f"select_time_colour: {label} time-varying colour, {short.iterations} iterations; "
            f"{len(part.train)} training views, {len(part.test)} validation views"
        )
        psnr.append(trained_psnr(part, variant, cloud, threads))
    gain, error = mean_and_error(psnr[0] - psnr[1], [view.camera.world_to_cam.tobytes() for view in part.test])
    return Selection(gain, error, len(part.test), time.perf_counter() - started)


def mean_and_error(gains: np.ndarray, poses: Sequence[Hashable]) -> tuple[float, float]:
    """Mean of `gains`, (views,) with at least two views, and its standard error.

    The standard error is over poses, because the frames of one camera are not independent; with a single pose it is
    over frames.
    """
    groups: dict[Hashable, list[float]] = defaultdict(list)
    for pose, gain in zip(poses, gains.tolist(), strict=True):
        groups[pose].append(gain)
    samples = np.array([np.mean(group) for group in groups.values()]) if len(groups) > 1 else gains
    return float(samples.mean()), float(samples.std(ddof=1) / len(samples) ** 0.5)


def trained_psnr(part: Scene, cfg: Config, cloud: Reconstruction | None, threads: int) -> np.ndarray:
    """(test views,) dB, of a model trained on `part.train`."""

    def evaluate_fn(model: Model, progress: Progress) -> dict:
        return {"psnr": float(held_out_psnr(model, part, cfg, threads).mean())}

    initial = initialise(part, cfg, stream(cfg.seed, Stream.INIT), cloud)
    with temporary_run() as run:
        model = train(initial, part, cfg, run, evaluate_fn).model
    return held_out_psnr(model, part, cfg, threads)
