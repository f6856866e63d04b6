"""The training loop: render a batch, step, refine the set of Gaussians, log, evaluate, save (docs/method.md 2).

The result is a function of the configuration, the data and the seed: the number of threads and interruptions do not
change a bit of it. The exception is `train.time_budget_s`: how many iterations fit into it depends on the machine.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from datasets.scene import Scene
from pipeline.config.schema import Config
from pipeline.data.lidar.depth_targets import DepthTargets
from pipeline.data.optical_flow import FlowTargets
from pipeline.data.sfm.depth_targets import PointDepths
from pipeline.data.training_views import TrainingViews
from pipeline.model.model import Model
from pipeline.model.velocities import in_rotations
from pipeline.terminal import interruption
from pipeline.training.density.refinement import RefinementViews, refine
from pipeline.training.objective.losses import psnr
from pipeline.training.objective.regularization import relative_to_data
from pipeline.training.progress import TrainingProgress
from pipeline.training.run_log import RunLog
from pipeline.training.schedule import Phase
from pipeline.training.state import TrainState, save, start
from pipeline.training.step import Batch, draw_batch, optimiser_step, render_batch

PROGRESS_EVERY = 10  # iterations between updates of the progress bar, whose PSNR costs half a millisecond
LOG_EVERY = 100  # iterations between lines of log.jsonl; a multiple of PROGRESS_EVERY


@dataclass(frozen=True)
class Progress:
    """Progress of training, for the evaluation callback."""

    iteration: int
    train_seconds: float  # evaluation excluded


@dataclass(frozen=True)
class TrainResult:
    """The trained model, in rotations, and its statistics. The run folder's checkpoint has what is trained: velocities
    with `train.explicit_velocity`."""

    model: Model
    iteration: int
    train_seconds: float
    best: dict | None  # the evaluation with the highest PSNR: what the callback returned, and `iteration`
    best_model: Model | None
    optimiser_bytes: int  # of Adam's moments


EvaluateFn = Callable[[Model, Progress], dict]  # returns psnr, and optionally ssim, test_loss and psnr_moving


class Watcher(Protocol):
    """Looks on while a model is trained, such as the live view; changes nothing. Its time is not training time."""

    def see(self, model: Model, iteration: int, loss: float, psnr: float) -> None:
        """Called every PROGRESS_EVERY iterations. loss: of the last batch; psnr: of its last view."""


def train(
    model: Model,
    scene: Scene,
    cfg: Config,
    run: RunLog,
    evaluate_fn: EvaluateFn,
    start_seconds: float = 0.0,
    watcher: Watcher | None = None,
) -> TrainResult:
    """Train `model` on `scene.train`, or continue from the run folder's checkpoint if `cfg.resume`.

    `model` is changed in place, unless a checkpoint replaces it or with `train.explicit_velocity`.

    evaluate_fn: called every `train.eval_every` iterations and at the end; its time is not training time.
    start_seconds: of training, before a new run.
    Raises finite_checks.NonFiniteError, with the last checkpoint kept, and ValueError for a checkpoint of another run.
    """
    state = start(model, scene, cfg, run, start_seconds)
    flows = FlowTargets(scene) if cfg.train.regularization.flow > 0 and state.model.kind.moves else None
    depths = _depths(scene, cfg)
    regularization = relative_to_data(cfg.train.regularization, scene)
    if state.iteration == 0:
        weights = {"motion": regularization.motion, "opacity": regularization.opacity}
        run.log({"event": "regularization", "iteration": 0, **weights})
    views, refinement_views = TrainingViews(scene.train, flows, depths), RefinementViews.of(scene)

    with TrainingProgress(state.iteration, cfg.train.iterations, cfg.train.time_budget_s) as progress:
        finished = state.is_finished(cfg.train)
        while not finished:
            phase = state.begin_iteration(scene, cfg)
            batch = render_batch(state, draw_batch(state, views, phase, scene, cfg), phase, scene, cfg)
            optimiser_step(state, batch, phase, scene, regularization)

            if state.iteration % PROGRESS_EVERY == 0:
                _report_progress(state, batch, phase, progress, run)
                if watcher is not None:
                    with state.stopwatch.paused():
                        watcher.see(state.model, state.iteration, batch.loss, psnr(batch.last.image, batch.last.target))
            finished = state.is_finished(cfg.train)
            # Before refinement, whose new and split Gaussians no step has fitted yet; the last model is not refined.
            if finished or state.iteration % cfg.train.eval_every == 0:
                _evaluate(state, evaluate_fn, progress, run)
            if not finished:
                for event in refine(state, phase, refinement_views, scene, cfg):
                    run.log(event)
            if finished or state.iteration % cfg.train.checkpoint_every == 0:
                save(state, run)
            interruption.raise_if_lost()
    best = None if state.best_model is None else in_rotations(state.best_model)
    return TrainResult(
        in_rotations(state.model), state.iteration, state.stopwatch.seconds, state.best, best, state.optimiser.bytes
    )


def _depths(scene: Scene, cfg: Config) -> DepthTargets | PointDepths | None:
    """What the depth loss compares with: the LiDAR, without one the points that the scene started from."""
    if scene.sweeps:
        return DepthTargets(scene) if cfg.train.depth.lidar > 0 else None
    return PointDepths(scene, scene.points) if scene.points is not None and cfg.train.depth.sfm > 0 else None


def _report_progress(state: TrainState, batch: Batch, phase: Phase, progress: TrainingProgress, run: RunLog) -> None:
    """Update the progress bar and, every LOG_EVERY iterations, log.jsonl."""
    seconds, quality = state.stopwatch.seconds, psnr(batch.last.image, batch.last.target)
    progress.update(state.iteration, batch.loss, quality, batch.n_gaussians, batch.n_alive, seconds)
    if state.iteration % LOG_EVERY == 0:
        run.log({
            "event": "train", "iteration": state.iteration, "train_seconds": seconds, "loss": batch.loss,
            "psnr": quality, "n_gaussians": batch.n_gaussians, "n_alive": batch.n_alive, "resolution": phase.resolution,
            "sh_degree": phase.sh_degree, "fourier_order": phase.fourier_order,
        })  # fmt: skip


def _evaluate(state: TrainState, evaluate_fn: EvaluateFn, progress: TrainingProgress, run: RunLog) -> None:
    """Append a row to error_vs_time.csv, and keep the best model so far."""
    with state.stopwatch.paused():
        reached = Progress(state.iteration, state.stopwatch.seconds)
        metrics = evaluate_fn(state.model, reached)
        run.append_error_vs_time({
            "train_seconds": reached.train_seconds, "iteration": reached.iteration, "psnr": metrics["psnr"],
            "ssim": metrics.get("ssim"), "test_loss": metrics.get("test_loss"), "n_gaussians": len(state.model),
            "psnr_moving": metrics.get("psnr_moving"),
        })  # fmt: skip
        if state.best is None or metrics["psnr"] > state.best["psnr"]:
            state.best, state.best_model = dict(metrics, iteration=reached.iteration), state.model.copy()
    progress.line(
        f"iteration {reached.iteration}: held-out psnr {metrics['psnr']:.2f} after "
        f"{reached.train_seconds:.0f} s of training, {len(state.model)} Gaussians"
    )
