"""Everything that changes while a model trains, and how it is saved to a checkpoint and restored from one."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from datasets.scene import Scene
from pipeline.config.random_streams import Stream, split_stream, stream
from pipeline.config.schema import Config
from pipeline.config.train_schema import TrainConfig
from pipeline.model.environment_map import EnvironmentMap
from pipeline.model.model import Model
from pipeline.training import checkpoint as checkpoints
from pipeline.training import finite_checks
from pipeline.training.density.statistics import Statistics
from pipeline.training.kernels import Kernels
from pipeline.training.optimiser import Adam
from pipeline.training.run_log import RunLog
from pipeline.training.sampling import BatchSampler
from pipeline.training.schedule import Phase, clock, phase
from pipeline.training.stopwatch import Stopwatch
from rasterizer import Gradients
from rasterizer.cores import thread_count


@dataclass
class TrainState:
    """A run between two iterations. A checkpoint holds all of it but the buffers, which an iteration begins anew."""

    model: Model
    optimiser: Adam
    statistics: Statistics  # of densification, since the last change of the set of Gaussians
    sampler: BatchSampler
    split_rng: torch.Generator
    seed: int
    kernels: Kernels
    gradients: Gradients  # buffer, summed over a batch
    stopwatch: Stopwatch
    iteration: int = 0
    best: dict | None = None  # the evaluation with the highest PSNR
    best_model: Model | None = None

    @property
    def threads(self) -> int:
        return self.kernels.threads

    def is_finished(self, cfg: TrainConfig) -> bool:
        budget = cfg.time_budget_s
        return self.iteration >= cfg.iterations or (budget is not None and self.stopwatch.seconds >= budget)

    def begin_iteration(self, scene: Scene, cfg: Config) -> Phase:
        """Count the next iteration; returns what the schedule says of it."""
        self.iteration += 1
        now = clock(self.iteration, self.stopwatch.seconds, cfg.train)
        return phase(now, cfg.train, scene.extent, self.model.kind.sh_degree, self.model.kind.fourier_order)

    def zero_gradients(self) -> None:
        """Zero gradients for the Gaussians there are now; the last iteration may have changed their set."""
        if len(self.gradients.mean) == len(self.model):
            self.gradients.zero_(self.threads)
        else:
            self.gradients = Gradients.zeros_like(self.model.gaussians())

    def reset_statistics(self) -> None:
        """Begin the densification statistics anew, for the Gaussians there are now."""
        self.statistics = Statistics(len(self.model))


def start(model: Model, scene: Scene, cfg: Config, run: RunLog, begin: int, spent: float) -> TrainState:
    """A fresh state around `model`, or the one saved in the run folder. begin, spent: as `loop.train`."""
    path, threads = run.path / checkpoints.FILE_NAME, thread_count(cfg.threads)
    if not cfg.resume:
        path.unlink(missing_ok=True)  # or a later resume would continue the run that this one replaces
    saved = checkpoints.load(path) if path.exists() else None
    if cfg.effective_background_model == "envmap":  # init.ply has no environment map
        model.environment_map = EnvironmentMap.grey(cfg.train.envmap_height)
    if saved is not None:
        expected, found = (
            f"seed {seed}, {of.kind} and background {of.background_model}"
            for seed, of in ((cfg.seed, model), (saved.seed, saved.model))
        )
        if found != expected:
            raise ValueError(f"{path}: expected a checkpoint of {expected}, found {found}")
        model = saved.model
    state = TrainState(
        model,
        Adam(model, threads),
        Statistics(len(model)),
        # A random stream for each purpose: what one draws never shifts another.
        BatchSampler(scene.train, cfg.train.sampler, cfg.train.batch, stream(cfg.seed, Stream.BATCHES)),
        split_stream(cfg.seed),
        cfg.seed,
        Kernels(cfg.train.ssim_weight, threads),
        Gradients.zeros_like(model.gaussians()),
        Stopwatch(spent),
        iteration=begin,
    )
    if saved is not None:
        _restore(state, saved)
        if saved.moments is None and not state.is_finished(cfg.train):
            raise ValueError(
                f"{path}: expected Adam's moments to continue from iteration {saved.iteration}, found none "
                "(train.checkpoint_keep_moments was false)"
            )
    run.truncate_after(state.iteration)
    return state


def save(state: TrainState, run: RunLog, keep_moments: bool) -> None:
    """Write the checkpoint. Raises finite_checks.NonFiniteError instead where the model is broken."""
    finite_checks.check_model(state.model, state.iteration)
    optimiser = state.optimiser
    checkpoints.save(
        run.path / checkpoints.FILE_NAME,
        checkpoints.Checkpoint(
            iteration=state.iteration,
            train_seconds=state.stopwatch.seconds,
            seed=state.seed,
            model=state.model,
            step_count=optimiser.step_count,
            moments=(optimiser.first, optimiser.second) if keep_moments else None,
            environment_moments=optimiser.environment_map if keep_moments else None,
            statistics=state.statistics.state(),
            sampler=state.sampler.state(),
            split_generator=state.split_rng.get_state(),
            best=state.best,
            best_model=state.best_model,
        ),
    )


def _restore(state: TrainState, saved: checkpoints.Checkpoint) -> None:
    """Everything of a checkpoint but the model, which the state is made around."""
    state.iteration, state.best, state.best_model = saved.iteration, saved.best, saved.best_model
    state.stopwatch = Stopwatch(saved.train_seconds)
    if saved.moments is not None:
        state.optimiser.first, state.optimiser.second = saved.moments
        state.optimiser.environment_map = saved.environment_moments
    state.optimiser.step_count = saved.step_count
    state.statistics = Statistics.restored(saved.statistics)
    state.sampler.restore(saved.sampler)
    state.split_rng.set_state(saved.split_generator)
