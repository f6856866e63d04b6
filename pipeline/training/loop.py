"""The training loop: render a batch, step, refine the set of Gaussians, log, evaluate, save (docs/method.md 2).

The result is a function of the configuration, the data and the seed: the number of threads and interruptions do not
change a bit of it. The exception is `train.time_budget_s`: how many iterations fit into it depends on the machine.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import torch
from torch import Tensor

from datasets.scene import Scene
from pipeline.config.schema import Config
from pipeline.data.depth_targets import DepthTargets, PointDepths
from pipeline.data.optical_flow import FlowTargets
from pipeline.data.training_views import TrainingViews
from pipeline.model.model import Model
from pipeline.model.transformed import in_rotations
from pipeline.terminal import interruption
from pipeline.training.density.refinement import refine, refiners
from pipeline.training.objective.objective import Objective
from pipeline.training.reporting import NOTHING_SPENT, Observer, Progress, RunLog, Spent, StepReport
from pipeline.training.schedule import Phase, is_evaluated
from pipeline.training.state import TrainState, save, start
from pipeline.training.step import Batch, draw_batch, optimiser_step, render_batch

REPORT_EVERY = 10  # iterations between reports, whose PSNR costs half a millisecond
# Seconds of training without a checkpoint, before the first and later: little is lost where iterations are slow.
FIRST_SAVE_S, SAVE_EVERY_S = 45.0, 600.0
LOG_EVERY = 100  # iterations between lines of log.jsonl; a multiple of REPORT_EVERY


@dataclass(frozen=True)
class TrainResult:
    """The trained model, in rotations, and its statistics. The run folder's checkpoint has what is trained: velocities
    where `train.motion` says so."""

    model: Model
    iteration: int
    spent: Spent
    best: dict | None  # the evaluation with the highest PSNR: what the callback returned, and `iteration`
    best_model: Model | None
    optimiser_bytes: int  # of Adam's moments


EvaluateFn = Callable[[Model, Progress], dict]  # returns psnr, and optionally ssim, test_loss and psnr_moving


def train(
    model: Model,
    scene: Scene,
    cfg: Config,
    run: RunLog,
    evaluate_fn: EvaluateFn,
    before: Spent = NOTHING_SPENT,
    observers: Sequence[Observer] = (),
) -> TrainResult:
    """Train `model` on `scene.train`, or continue from the run folder's checkpoint if `cfg.resume`.

    `model` is changed in place, unless a checkpoint replaces it or velocities are trained.

    evaluate_fn: called when schedule.is_evaluated and at the end; its time is not training time.
    before: time of training before a new run.
    Raises finite_checks.NonFiniteError, with the last checkpoint kept, and ValueError for a checkpoint of another run.
    """
    state = start(model, scene, cfg, run, before)
    folder = Path(cfg.scene.cache).expanduser()
    flows = FlowTargets(scene, folder) if cfg.train.regularization.flow > 0 and state.model.kind.moves else None
    views = TrainingViews(scene.train, flows, _depths(scene, cfg))
    objective, density = Objective(scene, cfg, state.threads), refiners(scene, cfg)
    for observer in observers:
        observer.start(state.iteration)

    saved, unsaved_for = state.stopwatch.seconds, FIRST_SAVE_S if state.iteration == 0 else SAVE_EVERY_S
    finished = state.is_finished(cfg.train)
    while not finished:
        phase = state.begin_iteration(scene, cfg)
        drawn = draw_batch(state, views, phase, scene, cfg)
        batch = render_batch(state, drawn, phase, objective, scene, cfg)
        optimiser_step(state, batch, phase, scene, cfg)

        if state.iteration % REPORT_EVERY == 0:
            _report(state, batch, phase, run, observers)
        finished = state.is_finished(cfg.train)
        # Before refinement, whose new and split Gaussians no step has fitted yet; the last model is not refined.
        if finished or is_evaluated(state.iteration, cfg.train.eval_every):
            _evaluate(state, evaluate_fn, run, observers)
        if not finished:
            for event in refine(state, phase, density):
                run.log(event)
        due = state.stopwatch.seconds - saved >= unsaved_for or state.iteration % cfg.train.checkpoint_every == 0
        stopped = interruption.stop_noted()
        if finished or due or stopped:
            save(state, run)
            saved, unsaved_for = state.stopwatch.seconds, SAVE_EVERY_S
        if stopped:
            raise interruption.Stopped
    best = None if state.best_model is None else in_rotations(state.best_model)
    return TrainResult(
        in_rotations(state.model), state.iteration, state.stopwatch.spent, state.best, best, state.optimiser.bytes
    )


def psnr(image: Tensor, target: Tensor) -> float:
    """PSNR of the clamped image in dB, infinite for equal images; for progress, not for results."""
    error = torch.mean((image.clamp(0.0, 1.0) - target) ** 2).item()
    return math.inf if error == 0 else -10.0 * math.log10(error)


def _depths(scene: Scene, cfg: Config) -> DepthTargets | PointDepths | None:
    """What the depth loss compares with: the LiDAR, without one the points that the scene started from."""
    if scene.sweeps:
        return DepthTargets(scene) if cfg.train.depth.lidar > 0 else None
    if scene.points is None or scene.points.times is not None or cfg.train.depth.sfm == 0:  # with times: no surfaces
        return None
    return PointDepths(scene, scene.points)


def _report(state: TrainState, batch: Batch, phase: Phase, run: RunLog, observers: Sequence[Observer]) -> None:
    """Tell the observers and, every LOG_EVERY iterations, log.jsonl."""
    assert batch.last is not None
    quality = psnr(batch.last.image, batch.last.target)
    report = StepReport(state.iteration, state.stopwatch.seconds, batch.loss, quality, batch.n_gaussians, batch.n_alive)
    if state.iteration % LOG_EVERY == 0:
        schedule = {"resolution": phase.resolution, "sh_degree": phase.sh_degree, "fourier_order": phase.fourier_order}
        run.log({"event": "train", **asdict(report), **schedule})
    with state.stopwatch.paused():
        for observer in observers:
            observer.step(state.model, report)


def _evaluate(state: TrainState, evaluate_fn: EvaluateFn, run: RunLog, observers: Sequence[Observer]) -> None:
    """Append a row to error_vs_time.csv, and keep the best model so far."""
    with state.stopwatch.paused():
        spent = state.stopwatch.spent
        reached = Progress(state.iteration, spent.seconds)
        metrics = evaluate_fn(state.model, reached)
        run.append_error_vs_time({
            "train_seconds": spent.seconds, "cpu_seconds": spent.cpu_seconds, "iteration": reached.iteration,
            "psnr": metrics["psnr"], "ssim": metrics.get("ssim"), "test_loss": metrics.get("test_loss"),
            "n_gaussians": len(state.model), "psnr_moving": metrics.get("psnr_moving"),
        })  # fmt: skip
        if state.best is None or metrics["psnr"] > state.best["psnr"]:
            state.best, state.best_model = dict(metrics, iteration=reached.iteration), state.model.copy()
        for observer in observers:
            observer.evaluated(state.model, reached, metrics)
