"""What a scene needs, decided by validation before its training: time at all, and colour that changes in time.

A part of the model that a scene does not need fits noise and costs memory and time. A single camera sees every moment
from one side only, so a model with time can be worse between its frames than one without; and 4DSH has two thirds of a
Gaussian's parameters. So the model is trained with the part and without, in a fraction of the schedule and at half
resolution or less, on three quarters of the training poses, and compared on the other quarter. Test views are not used.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from datasets.files.errors import SceneError
from datasets.scene import Scene
from datasets.validation import hold_out_poses
from pipeline.config.random_streams import Stream, stream
from pipeline.config.schema import Config
from pipeline.config.train_schema import TrainConfig
from pipeline.data.sfm.reconstruction import Reconstruction
from pipeline.evaluation.quick_evaluate import held_out_psnr
from pipeline.evaluation.renderer import Renderer
from pipeline.evaluation.rivals import AgainstRivals, Rivals
from pipeline.model.initialise import initialise
from pipeline.model.model import Model, kind_of
from pipeline.stages.training_progress import TrainingProgress
from pipeline.training import schedule
from pipeline.training.loop import train
from pipeline.training.reporting import Progress, Spent, temporary_run
from rasterizer import engine_for
from rasterizer.cores import thread_count

VALIDATION_EVERY = 4  # every fourth pose is a validation pose
RESOLUTION = 0.5  # × the schedule's
# Pixels of the longer side, where they are fewer: shared motion is told apart as well, in two thirds of the time.
MOTION_SIDE = 100
TIME_SHARE, COLOUR_SHARE, MOTION_SHARE = 0.1, 0.1, 0.15  # of the schedule's iterations, of each short training
FEWEST_ITERATIONS = 150  # of a short training, or all of the schedule: fewer show no more than a blur
STANDARD_ERRORS = 2.0  # of the gain by time, which must be larger
SHARED_GAIN = 1.0  # dB, of training views and of held-out ones, by shared motion: of bodies both are above 2
# Training views for shared motion. With lego's 50 it fits these better, and outermost held-out views worse.
FEWEST_SHARED = 75
# dB, and standard errors, of the gain by time-varying colour. Leaving out colours that do change costs more than
# keeping coefficients that have no use.
COLOUR_GAIN, COLOUR_STANDARD_ERRORS = 0.1, 1.0
# dB, of training views, from which any gain keeps it: 1.5 and more where light changes, elsewhere at most 0.8.
COLOUR_FIT_GAIN = 1.0
# × the learning rates of 4DSH's time coefficients, which would hardly leave zero in so few iterations. 1 decides
# wrongly on one of two scenes with changing colours; 10 makes the model worse than one without.
COLOUR_RATE = 3.0
FEWEST_VIEWS = {"time": 3, "motion": 3, "colour": 2}  # of validation; a single view has no standard error


@dataclass(frozen=True)
class Comparison:
    """A model with a part and without it, on the validation views."""

    psnr_with: float  # dB, mean over the views
    psnr_without: float
    gain: float  # dB, mean over the poses
    standard_error: float  # dB, of the gain
    fit_gain: float  # dB, of the mean PSNR of training views
    against: AgainstRivals  # of the better one
    views: int
    seconds: float  # of both trainings, of the clock
    cpu_seconds: float

    def __str__(self) -> str:
        return (
            f"on {self.views} validation views {self.psnr_with:.2f} dB with, {self.psnr_without:.2f} dB without "
            f"({self.gain:+.2f} ± {self.standard_error:.2f}; on training views {self.fit_gain:+.2f})"
        )

    @property
    def decidable(self) -> bool:
        """Whether one of both shows more than a blur; of two blurs neither is better. The nearest view is no bar: of a
        slow clip it is better than any model after so few iterations."""
        return self.against.learnt

    @property
    def beyond_chance(self) -> bool:
        """Time is kept where it gains more than chance."""
        return self.gain > STANDARD_ERRORS * self.standard_error

    @property
    def takes_shared_motion(self) -> bool:
        """Shared motion is taken where it follows what moves: in as many iterations it then fits the training views
        better, and shows others better. Of what flies it does one at most, so early."""
        return min(self.gain, self.fit_gain) > SHARED_GAIN

    @property
    def keeps_colour(self) -> bool:
        """Time-varying colour is kept where it gains clearly, or gains while it explains the training views."""
        if self.fit_gain > COLOUR_FIT_GAIN:
            return self.gain > 0
        return self.gain > max(COLOUR_GAIN, COLOUR_STANDARD_ERRORS * self.standard_error)


def time_is_open(cfg: Config, scene: Scene) -> bool:
    """Whether validation decides between static and dynamic: the scene may be static, one moving camera filmed it, and
    its model may have time. False with a time budget, all of which is for the schedule."""
    if not cfg.scene.may_be_static or cfg.train.time_budget_s is not None or cfg.ablation.static is not None:
        return False
    if kind_of(scene, cfg).motion == "static" or scene.several_cameras:
        return False
    poses = {view.camera.world_to_cam.tobytes() for view in scene.train}
    return len(poses) == len(scene.train) and _has_validation(scene, FEWEST_VIEWS["time"])


def colour_is_open(cfg: Config, scene: Scene) -> bool:
    """Whether validation decides on time-varying colour: the schedule asks for it and the model has it."""
    if not cfg.train.select or cfg.train.time_budget_s is not None:
        return False
    return kind_of(scene, cfg).fourier_order > 0 and _has_validation(scene, FEWEST_VIEWS["colour"])


def compare_time(cfg: Config, scene: Scene, cloud: Reconstruction | None, log: Callable[[str], None]) -> Comparison:
    """With time and without, in one schedule: the settings of static scenes alone gain more in so short a training."""
    short = replace(cfg, train=short_schedule(cfg.train, TIME_SHARE), resume=False)
    return _compared("time", without_time_colour(short), without_time(short), scene, cloud, log)


def shared_motion_is_open(cfg: Config, scene: Scene) -> bool:
    """Whether validation decides on shared motion: the schedule asks for it, one camera filmed from everywhere, and the
    model has 4D rotations and no sphere around the scene, which would draw the anchors. False with few views."""
    if not cfg.train.select or cfg.train.time_budget_s is not None or not cfg.ablation.shared_motion:
        return False
    possible = scene.capture == "monocular" and kind_of(scene, cfg).motion == "full"
    possible = possible and len(scene.train) >= FEWEST_SHARED
    return possible and cfg.scene.background_model != "sphere" and _has_validation(scene, FEWEST_VIEWS["motion"])


def compare_shared_motion(
    cfg: Config, shared: Config, scene: Scene, cloud: Reconstruction | None, log: Callable[[str], None]
) -> Comparison:
    """Gaussians that share trajectories, by the settings `shared`, and those of the paper, by `cfg`; in colours
    constant in time, and in as many iterations."""
    iterations = MOTION_SHARE * cfg.train.iterations
    scale = motion_scale(scene, cfg.train.resolution_scale)
    with_it, without = (
        replace(
            without_time_colour(one),
            train=short_schedule(one.train, iterations / one.train.iterations, scale),
            resume=False,
        )
        for one in (shared, cfg)
    )
    return _compared("shared motion", with_it, without, scene, cloud, log)


def motion_scale(scene: Scene, resolution_scale: float) -> float:
    """× the schedule's resolution, which is `resolution_scale` × the images', where shared motion is compared."""
    longest = max(max(view.camera.width, view.camera.height) for view in scene.train)
    return min(RESOLUTION, MOTION_SIDE / (resolution_scale * longest))


def compare_colour(cfg: Config, scene: Scene, cloud: Reconstruction | None, log: Callable[[str], None]) -> Comparison:
    """With time-varying colour and without."""
    schedule = _faster_colour(short_schedule(cfg.train, COLOUR_SHARE))
    short = replace(cfg, train=schedule, resume=False)
    return _compared("time-varying colour", short, without_time_colour(short), scene, cloud, log)


def without_time(cfg: Config) -> Config:
    """The configuration of the static model: that of the ablation `static`."""
    return replace(cfg, ablation=replace(cfg.ablation, static=True))


def without_time_colour(cfg: Config) -> Config:
    """The configuration without time-varying colour: that of the ablation `no_4dsh`."""
    return replace(cfg, ablation=replace(cfg.ablation, fourier_order=0))


def _compared(
    part: str,
    with_part: Config,
    without: Config,
    scene: Scene,
    cloud: Reconstruction | None,
    log: Callable[[str], None],
) -> Comparison:
    """Train both on `scene.train`. Deterministic in scene, configuration and seed, except for the seconds."""
    started, split = Spent.by_now(), hold_out_poses(scene, VALIDATION_EVERY)
    psnr, fit, standings, rivals = [], [], [], Rivals(split, with_part.train.resolution_scale)
    for cfg, label in ((with_part, "with"), (without, "without")):
        log(
            f"settle: {label} {part}, {cfg.train.iterations} iterations; {len(split.train)} training views, "
            f"{len(split.test)} validation views"
        )
        held_out, fitted, renderer = trained_psnr(split, cfg, cloud)
        standings.append(rivals.compare(renderer))
        psnr.append(held_out)
        fit.append(fitted)
    gain, error = mean_and_error(psnr[0] - psnr[1], [view.camera.world_to_cam.tobytes() for view in split.test])
    spent = Spent.by_now() - started
    means = float(psnr[0].mean()), float(psnr[1].mean())
    against = max(standings, key=lambda standing: standing.model)
    return Comparison(*means, gain, error, fit[0] - fit[1], against, len(split.test), spent.seconds, spent.cpu_seconds)


def _has_validation(scene: Scene, views: int) -> bool:
    """Whether the training views can give so many for validation, and the others still have an extent."""
    try:
        split = hold_out_poses(scene, VALIDATION_EVERY)
    except SceneError:
        return False
    return split.extent > 0 and len(split.test) >= views


def short_schedule(cfg: TrainConfig, share: float, scale: float = RESOLUTION) -> TrainConfig:
    """`share` of the schedule at `scale` × its resolution, evaluated at its end only. Without the flow loss: measuring
    the flow would take longer than the training."""
    short = schedule.shortened(cfg, min(1.0, max(share, FEWEST_ITERATIONS / cfg.iterations)))
    return replace(
        short,
        resolution_scale=scale * short.resolution_scale,
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


def trained_psnr(split: Scene, cfg: Config, cloud: Reconstruction | None) -> tuple[np.ndarray, float, Renderer]:
    """Of a model trained on `split.train`, with smaller batches if it has fewer views than one: (test views,) dB, the
    mean over about as many training views, and the model."""
    cfg = replace(cfg, train=replace(cfg.train, batch=min(cfg.train.batch, len(split.train))))
    threads = thread_count(cfg.threads)

    def evaluate_fn(model: Model, progress: Progress) -> dict:
        return {"psnr": float(held_out_psnr(model, split, cfg, threads).mean())}

    initial = initialise(split, cfg, stream(cfg.seed, Stream.INIT), cloud)
    with temporary_run() as run, TrainingProgress(cfg.train.iterations, None) as bar:
        model = train(initial, split, cfg, run, evaluate_fn, observers=[bar]).model
    fitted = replace(split, test=split.train[:: -(-len(split.train) // len(split.test))])
    renderer = Renderer(model, split, cfg, engine_for(cfg.backend, threads))
    fit = float(held_out_psnr(model, fitted, cfg, threads).mean())
    return held_out_psnr(model, split, cfg, threads), fit, renderer


def _faster_colour(cfg: TrainConfig) -> TrainConfig:
    def faster(rate: float | None) -> float:
        return COLOUR_RATE * (cfg.lr.sh_rest if rate is None else rate)

    return replace(cfg, lr=replace(cfg.lr, sh_time=faster(cfg.lr.sh_time), sh_view_time=faster(cfg.lr.sh_view_time)))
