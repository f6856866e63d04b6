"""The state of training: everything that an iteration changes, saved to and restored from a checkpoint."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import torch

from datasets.scene import Scene
from pipeline.config.random_streams import Stream, split_stream, stream
from pipeline.config.schema import Config
from pipeline.config.train_schema import TrainConfig
from pipeline.model.cube_map import CubeMap
from pipeline.model.environment_map import EnvironmentMap
from pipeline.model.model import Model
from pipeline.model.shared_motion import with_trajectories
from pipeline.model.transformed import in_velocities
from pipeline.training import checkpoint as checkpoints
from pipeline.training import finite_checks
from pipeline.training.density.statistics import Statistics
from pipeline.training.objective.neighbours import SEARCH_EVERY, Neighbours, find_neighbours
from pipeline.training.optimiser import Adam
from pipeline.training.reporting import NOTHING_SPENT, RunLog, Spent
from pipeline.training.sampling import BatchSampler
from pipeline.training.schedule import Phase, at_all_times, clock_at, on_tracks, phase
from rasterizer import Gradients
from rasterizer.cores import thread_count
from rasterizer.engine import device_of

MAP_HEIGHT = 500  # rows of the environment map, as in the release; it has twice as many columns
CUBE_MAP_RESOLUTION = 128  # texels along a side of the cube map's faces


class Stopwatch:
    """Training time: starts on creation, continued from a checkpoint, paused during evaluation."""

    def __init__(self, before: Spent) -> None:
        self._before = before
        self._since: Spent | None = Spent.by_now()

    @property
    def spent(self) -> Spent:
        return self._before if self._since is None else self._before + (Spent.by_now() - self._since)

    @property
    def seconds(self) -> float:
        return self.spent.seconds

    @contextmanager
    def paused(self) -> Iterator[None]:
        self._before, self._since = self.spent, None
        try:
            yield
        finally:
            self._since = Spent.by_now()


@dataclass
class TrainState:
    """A run between two iterations. A checkpoint has all of it except the buffers, which every iteration resets."""

    model: Model
    optimiser: Adam
    statistics: Statistics  # of densification, since the last change of the set of Gaussians
    sampler: BatchSampler
    split_rng: torch.Generator
    seed: int
    gradients: Gradients  # buffer; sums over a batch
    stopwatch: Stopwatch
    iteration: int = 0
    best: dict | None = None  # the evaluation with the highest PSNR
    best_model: Model | None = None
    neighbours: Neighbours | None = None  # None: to be found, if they are wanted

    @property
    def threads(self) -> int:
        return self.optimiser.threads

    def is_finished(self, cfg: TrainConfig) -> bool:
        budget = cfg.time_budget_s
        return self.iteration >= cfg.iterations or (budget is not None and self.stopwatch.seconds >= budget)

    def begin_iteration(self, scene: Scene, cfg: Config) -> Phase:
        """Increment the iteration and return its phase of the schedule."""
        self.iteration += 1
        if self.iteration % SEARCH_EVERY == 1:
            self.neighbours = None
        if self.neighbours is None and cfg.train.regularization.rigid > 0:
            self.neighbours = find_neighbours(self.model, self.threads)
        clock = clock_at(self.iteration, self.stopwatch.seconds, cfg.train)
        kind = self.model.kind
        found = phase(clock, cfg.train, scene.extent, kind.sh_degree, kind.fourier_order)
        if kind.trajectories:
            rates = at_all_times if cfg.train.motion == "trajectories" else on_tracks
            found = replace(found, lr=rates(found.lr))
        return found

    def zero_gradients(self) -> None:
        """Zero the gradients; allocate them again if the last iteration changed the number of Gaussians."""
        if len(self.gradients.mean) == len(self.model):
            self.gradients.zero_(self.threads)
        else:
            self.reset_gradients()

    def reset_gradients(self) -> None:
        """New gradients of the model's shapes."""
        self.gradients = Gradients.zeros_like(self.model.gaussians())

    def reset_statistics(self) -> None:
        """Start new densification statistics for the current Gaussians."""
        self.statistics = Statistics(len(self.model), self.model.device)


def start(model: Model, scene: Scene, cfg: Config, run: RunLog, before: Spent = NOTHING_SPENT) -> TrainState:
    """A new state with `model`, or the one saved in the run folder. before: as `loop.train`.

    Raises ValueError for a checkpoint of another seed or kind of model.
    """
    path, threads = run.path / checkpoints.FILE_NAME, thread_count(cfg.threads)
    if not cfg.resume:
        path.unlink(missing_ok=True)  # otherwise a later resume would continue the replaced run
    saved = checkpoints.load(path) if path.exists() else None
    if cfg.train.motion in ("tracks", "trajectories"):
        model = in_velocities(model)
    if cfg.train.motion == "trajectories" and model.kind.motion == "velocity" and model.trajectories is None:
        model = with_trajectories(model, scene)
    if model.environment_map is None:  # a new model: init.ply has none
        if cfg.scene.background_model == "envmap":
            model.environment_map = EnvironmentMap.grey(MAP_HEIGHT)
        elif cfg.scene.background_model == "cubemap":
            model.environment_map = CubeMap.grey(CUBE_MAP_RESOLUTION)
    if saved is not None:
        expected, found = (
            f"seed {seed}, {kind} and background {of.background_model}"
            for seed, of, kind in (
                (cfg.seed, model, model.kind),
                # Training adds the trajectories of tracks.
                (saved.seed, saved.model, replace(saved.model.kind, trajectories=model.kind.trajectories)),
            )
        )
        if found != expected:
            raise ValueError(f"{path}: expected a checkpoint of {expected}, found {found}")
        model = saved.model
    model = model.to(device_of(cfg.backend))
    state = TrainState(
        model,
        Adam(model, threads),
        Statistics(len(model), model.device),
        # One random stream per purpose, so that the draws of one never shift those of another.
        BatchSampler(len(scene.train), cfg.train.batch, stream(cfg.seed, Stream.BATCHES)),
        split_stream(cfg.seed),
        cfg.seed,
        Gradients.zeros_like(model.gaussians()),
        Stopwatch(before),
    )
    if saved is not None:
        _restore(state, saved)
    run.truncate_after(state.iteration)
    return state


def save(state: TrainState, run: RunLog) -> None:
    """Write the checkpoint. Raises finite_checks.NonFiniteError, and writes nothing, if the model is not finite."""
    finite_checks.check_model(state.model, state.iteration)
    optimiser = state.optimiser
    checkpoints.save(
        run.path / checkpoints.FILE_NAME,
        checkpoints.Checkpoint(
            iteration=state.iteration,
            spent=state.stopwatch.spent,
            seed=state.seed,
            model=state.model,
            step_count=optimiser.step_count,
            moments=(optimiser.first, optimiser.second),
            shared_moments=optimiser.shared_moments,
            statistics=state.statistics.state(),
            sampler=state.sampler.state(),
            split_rng=state.split_rng.get_state(),
            best=state.best,
            best_model=state.best_model,
            neighbours=state.neighbours,
        ),
    )


def _restore(state: TrainState, saved: checkpoints.Checkpoint) -> None:
    """Restore everything except the model, which `state` already has."""
    device = state.model.device
    state.iteration, state.best, state.neighbours = saved.iteration, saved.best, saved.neighbours
    state.best_model = None if saved.best_model is None else saved.best_model.to(device)
    state.stopwatch = Stopwatch(saved.spent)
    state.optimiser.first, state.optimiser.second = (
        {name: moment.to(device) for name, moment in moments.items()} for moments in saved.moments
    )
    state.optimiser.shared_moments = {
        name: (first.to(device), second.to(device)) for name, (first, second) in saved.shared_moments.items()
    }
    state.optimiser.step_count = saved.step_count
    state.statistics = Statistics.restored(saved.statistics, device)
    state.sampler.restore(saved.sampler)
    state.split_rng.set_state(saved.split_rng)
