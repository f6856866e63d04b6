"""What both selections share: a short training on part of the training views, and its PSNR on the others."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Hashable, Sequence
from dataclasses import replace

import numpy as np

from datasets.scene import Scene
from pipeline.config.random_streams import Stream, stream
from pipeline.config.schema import Config
from pipeline.config.train_schema import TrainConfig
from pipeline.data.sfm.photograph import Reconstruction
from pipeline.evaluation.quick_evaluate import held_out_psnr
from pipeline.model.initialise import initialise
from pipeline.model.model import Model
from pipeline.training import schedule
from pipeline.training.loop import Progress, train
from pipeline.training.run_log import temporary_run

VALIDATION_EVERY = 4  # every fourth pose is a validation pose
RESOLUTION = 0.5  # × the schedule's
MIN_STANDARD_ERRORS = 2.0  # of a gain, above zero


def short_schedule(cfg: TrainConfig, share: float) -> TrainConfig:
    """`share` of the schedule at half resolution, evaluated at its end only. Without the flow loss: measuring the flow
    would take longer than the training."""
    short = schedule.shortened(cfg, share)
    return replace(
        short,
        resolution_scale=RESOLUTION * short.resolution_scale,
        eval_every=short.iterations,
        checkpoint_every=short.iterations,
        regularization=replace(short.regularization, flow=0.0),
    )


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
    """(test views,) dB, of a model trained on `part.train`, with smaller batches if it has fewer views than one."""
    cfg = replace(cfg, train=replace(cfg.train, batch=min(cfg.train.batch, len(part.train))))

    def evaluate_fn(model: Model, progress: Progress) -> dict:
        return {"psnr": float(held_out_psnr(model, part, cfg, threads).mean())}

    initial = initialise(part, cfg, stream(cfg.seed, Stream.INIT), cloud)
    with temporary_run() as run:
        model = train(initial, part, cfg, run, evaluate_fn).model
    return held_out_psnr(model, part, cfg, threads)
