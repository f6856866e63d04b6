"""The training loop: render a batch, compare, step, densify, now and then evaluate and save (docs/method.md 2).

The result is a function of the configuration, the data and the seed, whatever the number of threads and however often
the run was killed and resumed. The one exception is `train.time_budget_s`: how far a run gets in a number of seconds,
and with it its schedule (schedule.clock), depends on the machine and its load.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import torch

from datasets.scene import Scene
from pipeline.config.random_streams import Stream, split_stream, stream
from pipeline.config.schema import Config
from pipeline.data.training_views import TrainingViews
from pipeline.model.environment_map import EnvironmentMap
from pipeline.model.model import Model
from pipeline.model.sphere import moving_rows
from pipeline.training import checkpoint as checkpoints
from pipeline.training import finite_checks as guard
from pipeline.training import schedule
from pipeline.training.density import densification as densify
from pipeline.training.density import sensitivity_pruning as leave_out
from pipeline.training.objective.losses import psnr
from pipeline.training.objective.random_background import over_random_background
from pipeline.training.objective.regularization import DECAY_EVERY, add_prior_gradients, decay_colors
from pipeline.training.optimiser import Adam
from pipeline.training.progress import TrainingDisplay
from pipeline.training.sampling import BatchSampler
from pipeline.training.step import Batch, Kernels
from rasterizer import Gradients

SHOW_EVERY = 10  # iterations between updates of the display; the PSNR it shows costs half a millisecond
LOG_EVERY = 100  # iterations between lines of log.jsonl; a multiple of SHOW_EVERY


class RunFolder(Protocol):
    """What training needs of a run folder; see run_folder.py."""

    path: Path

    def log(self, row: dict) -> None: ...  # a line of log.jsonl
    def append_error_vs_time(self, row: dict) -> None: ...
    def truncate_after(self, iteration: int) -> None: ...  # drop rows of later iterations from both


@dataclass(frozen=True)
class Progress:
    """How far training is, for the evaluation callback."""

    iteration: int
    train_seconds: float  # evaluation excluded
    resolution: float  # scale trained at; a model trained coarsely reads low when rendered at full size
    final: bool


@dataclass(frozen=True)
class TrainResult:
    """What training leaves in memory; the same is in the run folder's checkpoint."""

    model: Model
    iteration: int
    train_seconds: float
    best: dict | None  # the evaluation with the highest PSNR: what the callback returned, and `iteration`
    best_model: Model | None
    optimiser_bytes: int  # of Adam's moments


Evaluate = Callable[[Model, Progress], dict]  # returns at least psnr; ssim and test_loss if it can


@dataclass
class TrainState:
    """Everything that changes as a run goes on, and so everything a checkpoint holds."""

    model: Model
    optimiser: Adam
    statistics: densify.Statistics
    sampler: BatchSampler
    split_generator: torch.Generator
    iteration: int = 0
    best: dict | None = None
    best_model: Model | None = None


def train(
    model: Model, scene: Scene, cfg: Config, run: RunFolder, evaluate: Evaluate, begin: int = 0, spent: float = 0.0
) -> TrainResult:
    """Train `model` (in place) on `scene.train`, or continue from the run folder's checkpoint if `cfg.resume`.

    `evaluate` is called every `train.eval_every` iterations and at the end, off the clock. begin: iterations that a
    fresh run counts as done before its first; where the schedule begins for a model that is trained already. spent:
    seconds that count as training from the start. Raises guard.NonFiniteError, with the last good checkpoint kept, and
    ValueError for a checkpoint that does not fit.
    """
    state, watch = _start(model, scene, cfg, run, begin, spent)
    model, threads = state.model, thread_count(cfg.threads)
    views, kernels = TrainingViews(scene.train), Kernels(cfg.train.ssim_weight, threads)
    gradients = Gradients.zeros_like(model.gaussians())
    time_split = cfg.ablation.time_split and cfg.train.densify.time_split
    asked = leave_out.views_to_ask(scene)

    with TrainingDisplay(state.iteration, cfg.train.iterations, cfg.train.time_budget_s) as display:
        last = _done(state.iteration, watch.seconds, cfg)
        while not last:
            state.iteration += 1
            iteration, now = state.iteration, schedule.clock(state.iteration, watch.seconds, cfg.train)
            phase = schedule.phase(now, cfg.train, scene.extent, model.kind.sh_degree, model.kind.fourier_order)
            collect = now < cfg.train.densify.stop  # nobody else asks for the statistics

            # One batch: gradients and statistics of every view, then one step.
            targets = [(views.at(index, phase.resolution), scene.background) for index in state.sampler.next_batch()]
            if cfg.train.random_background:
                colors = stream(cfg.seed, Stream.BACKGROUND, iteration)
                targets = [over_random_background(*target, colors) for target in targets]
            batch = Batch(model, scene, cfg, kernels, phase, len(targets))
            gradients.zero_(threads)
            if collect:
                state.statistics.begin()
            for target, background in targets:
                view = batch.backward(target, background, gradients)
                guard.check_loss(view.loss, iteration, target.name, model)
                if collect:
                    state.statistics.add_view(view.gradient, target.camera, scene.duration, threads)
            if collect:
                state.statistics.end(len(targets))
            guard.check_gradients(
                gradients,
                iteration,
                [target.name for target, _ in targets],
                lambda position: batch.gradients_of(*targets[position]),
                threads,
            )
            add_prior_gradients(gradients, model, cfg.train.prior, scene)
            rows = moving_rows(model, phase.sphere, batch.touched)
            state.optimiser.step(gradients, phase.rates, rows, batch.d_environment)
            if cfg.train.prior.color > 0 and iteration % DECAY_EVERY == 0:
                decay_colors(model, cfg.train.prior.color, phase.rates["sh"][1])

            # The set of Gaussians changes in space and time.
            if densify.due(iteration, now, cfg.train.densify):
                state.statistics, done = densify.densify(
                    state.optimiser,
                    state.statistics,
                    iteration,
                    cfg.train.densify,
                    scene.extent,
                    time_split,
                    state.split_generator,
                    phase.sphere,
                )
                gradients = Gradients.zeros_like(model.gaussians())
                run.log(
                    {
                        "event": "densify",
                        "iteration": iteration,
                        "cloned": done.cloned,
                        "split": done.split,
                        "pruned": done.pruned,
                        "n_gaussians": done.total,
                    }
                )
            if leave_out.due(iteration, cfg.train):
                change = leave_out.missed(
                    model, asked, scene, cfg, phase.resolution, stream(cfg.seed, Stream.SENSITIVITY, iteration), threads
                )
                gone = leave_out.leave_out(
                    state.optimiser, change, cfg.train.densify.leave_out, len(asked) == len(scene.train)
                )
                state.statistics, gradients = densify.Statistics(len(model)), Gradients.zeros_like(model.gaussians())
                run.log({"event": "leave_out", "iteration": iteration, "left_out": gone, "n_gaussians": len(model)})
            if densify.opacity_reset_due(iteration, now, cfg.train.densify):
                densify.reset_opacity(state.optimiser, cfg.train.densify, phase.sphere)

            # What a person sees, and what is kept.
            if iteration % SHOW_EVERY == 0:
                quality = psnr(view.image, view.target)
                display.update(iteration, batch.loss, quality, batch.n_gaussians, batch.alive, watch.seconds)
                if iteration % LOG_EVERY == 0:
                    run.log(
                        {
                            "event": "train",
                            "iteration": iteration,
                            "train_seconds": watch.seconds,
                            "loss": batch.loss,
                            "psnr": quality,
                            "n_gaussians": batch.n_gaussians,
                            "n_alive": batch.alive,
                            "resolution": phase.resolution,
                            "sh_degree": phase.sh_degree,
                            "fourier_order": phase.fourier_order,
                        }
                    )
            last = _done(iteration, watch.seconds, cfg)
            if last or iteration % cfg.train.eval_every == 0:
                with watch.paused():
                    row = _evaluate(state, evaluate, run, Progress(iteration, watch.seconds, phase.resolution, last))
                display.line(
                    f"iteration {iteration}: held-out psnr {row['psnr']:.2f} after "
                    f"{watch.seconds:.0f} s of training, {len(model)} Gaussians"
                )
            if last or iteration % cfg.train.checkpoint_every == 0:
                guard.check_model(model, iteration)
                keep_moments = cfg.train.checkpoint_keep_moments or not last
                checkpoints.save(
                    run.path / checkpoints.FILE_NAME, _checkpoint(state, watch.seconds, cfg.seed, keep_moments)
                )
    return TrainResult(model, state.iteration, watch.seconds, state.best, state.best_model, state.optimiser.bytes)


def thread_count(threads: int) -> int:
    """0 means all this process may use."""
    return threads or len(os.sched_getaffinity(0))


class Stopwatch:
    """Training seconds: runs on from a checkpoint's, stands still while paused."""

    def __init__(self, seconds: float) -> None:
        self._before, self._since = seconds, time.perf_counter()

    @property
    def seconds(self) -> float:
        return self._before if self._since is None else self._before + time.perf_counter() - self._since

    @contextmanager
    def paused(self) -> Iterator[None]:
        self._before, self._since = self.seconds, None
        try:
            yield
        finally:
            self._since = time.perf_counter()


def _done(iteration: int, train_seconds: float, cfg: Config) -> bool:
    budget = cfg.train.time_budget_s
    return iteration >= cfg.train.iterations or (budget is not None and train_seconds >= budget)


def _start(
    model: Model, scene: Scene, cfg: Config, run: RunFolder, begin: int, spent: float
) -> tuple[TrainState, Stopwatch]:
    """A fresh state around `model`, or the one saved in the run folder."""
    path = run.path / checkpoints.FILE_NAME
    if not cfg.resume:
        path.unlink(missing_ok=True)  # or a later resume would continue the run that this one replaces
    saved = checkpoints.load(path) if path.exists() else None
    if cfg.background_model == "envmap":  # before training there is nothing to store of it: init.ply has none
        model.environment = EnvironmentMap.grey(cfg.train.environment_height)
    if saved is not None:
        expected, found = (
            f"seed {seed}, {of.kind} and background {of.background}"
            for seed, of in ((cfg.seed, model), (saved.seed, saved.model))
        )
        if found != expected:
            raise ValueError(f"{path}: expected a checkpoint of {expected}, found {found}")
        model = saved.model
    # One stream each, so that what one draws never shifts the other.
    sampler = BatchSampler(scene.train, cfg.train.sampler, cfg.train.batch, stream(cfg.seed, Stream.BATCHES))
    optimiser = Adam(model, thread_count(cfg.threads))
    state = TrainState(
        model, optimiser, densify.Statistics(len(model)), sampler, split_stream(cfg.seed), iteration=begin
    )
    if saved is None:
        run.truncate_after(begin)
        return state, Stopwatch(spent)

    state.iteration, state.best, state.best_model = saved.iteration, saved.best, saved.best_model
    if saved.moments is not None:
        state.optimiser.first, state.optimiser.second = saved.moments
        state.optimiser.environment = saved.environment_moments
    elif not _done(saved.iteration, saved.train_seconds, cfg):
        raise ValueError(
            f"{path}: expected Adam's moments to continue from iteration {saved.iteration}, found none "
            "(train.checkpoint_keep_moments was false)"
        )
    state.optimiser.step_count = saved.step_count
    state.statistics = densify.Statistics.restored(saved.statistics)
    state.sampler.restore(saved.sampler)
    state.split_generator.set_state(saved.split_generator)
    run.truncate_after(saved.iteration)
    return state, Stopwatch(saved.train_seconds)


def _evaluate(state: TrainState, evaluate: Evaluate, run: RunFolder, progress: Progress) -> dict:
    metrics = evaluate(state.model, progress)
    run.append_error_vs_time(
        {
            "train_seconds": progress.train_seconds,
            "iteration": progress.iteration,
            "psnr": metrics["psnr"],
            "ssim": metrics.get("ssim"),
            "test_loss": metrics.get("test_loss"),
            "n_gaussians": len(state.model),
        }
    )
    if state.best is None or metrics["psnr"] > state.best["psnr"]:
        state.best = dict(metrics, iteration=progress.iteration)
        state.best_model = state.model.copy()
    return metrics


def _checkpoint(state: TrainState, train_seconds: float, seed: int, keep_moments: bool) -> checkpoints.Checkpoint:
    optimiser = state.optimiser
    return checkpoints.Checkpoint(
        iteration=state.iteration,
        train_seconds=train_seconds,
        seed=seed,
        model=state.model,
        step_count=optimiser.step_count,
        moments=(optimiser.first, optimiser.second) if keep_moments else None,
        environment_moments=optimiser.environment if keep_moments else None,
        statistics=state.statistics.state(),
        sampler=state.sampler.state(),
        split_generator=state.split_generator.get_state(),
        best=state.best,
        best_model=state.best_model,
    )
