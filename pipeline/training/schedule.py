"""The schedule: learning rates, active SH degree and Fourier order, and resolution by iteration (docs/method.md 2).

All of them are functions of the `clock`, the position in the schedule, in iterations. It is the iteration, or larger in
a run whose time budget ends before its iterations do, so that decays reach their end.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from pipeline.config.scaled import scaled
from pipeline.config.train_schema import LearningRates, ResolutionStep, TrainConfig

SPHERE_FREEZE_AFTER = 10_000  # iterations for which the background sphere is trained, as in the paper
MAP_UNTIL = 5000  # iterations for which the environment map or the cube map is trained
MAP_LEARNING_RATE = 2.5e-3  # of their texels: that of the constant coefficients in 3DGS
# The paper's and 3DGS's: first and last of positions, × extent; of the constant coefficient, the opacity's logit, log
# scales and both quaternions.
MEAN_RATE, DC_RATE, OPACITY_RATE, SCALE_RATE, ROTATION_RATE = (1.6e-4, 1.6e-6), 2.5e-3, 5e-2, 5e-3, 1e-3
DECAY_START = 0.7  # fraction of the schedule after which the decay to `final_factor` begins
WEIGHTS_RATE, TRAJECTORY_RATE = (5e-3, 5e-4), (3.2e-4, 3.2e-6)  # first and last; of control points × extent
FULL_RATE_FROM = 2500  # iterations; in fewer these two are larger, so that trajectories reach as far
DEPTH_DECAY = 0.267  # weights of the depth loss: × exp(-fraction / this), as in the urban program of the authors
FIRST_EVALUATION = 30  # iterations; earlier ones would cost more than they show

LearningRate = float | tuple[float, ...]  # one for the field, or one per column


@dataclass(frozen=True)
class Phase:
    """The settings of one iteration."""

    clock: float  # position in the schedule, in iterations
    lr: dict[str, LearningRate]  # by field, and "environment"; "sh" as rasterizer.adam.sh_adam_step takes it
    sh_degree: int
    fourier_order: int
    resolution: float  # × the image size of the scene
    densification: bool  # whether its statistics are collected
    sphere: bool  # whether the sphere around the scene is trained (pipeline/model/sphere.py)
    environment_map: bool  # whether the environment map or cube map is trained (pipeline/model/environment_map.py)
    depth_decay: float = 0.0  # factor of the weights of the depth loss


def clock_at(iteration: int, train_seconds: float, cfg: TrainConfig) -> float:
    """Position in the schedule: `iteration`, or the used share of the time budget × iterations, whichever is larger."""
    if cfg.time_budget_s is None:
        return float(iteration)
    return max(float(iteration), cfg.iterations * min(1.0, train_seconds / cfg.time_budget_s))


@dataclass
class Passing:
    """Whether the clock passes `start`: in one iteration, though with a time budget it leaves values out."""

    start: int
    _before: float | None = None  # the clock of the iteration before; None: this process has made none

    def now(self, iteration: int, clock: float) -> bool:
        """To be asked in every iteration."""
        before = iteration - 1 if self._before is None else self._before
        self._before = clock
        return before < self.start <= clock


def early_evaluations(every: int) -> list[int]:
    """Iterations before `every` at which held-out views are evaluated too: 1/2, 1/4, 1/8 and 1/16 of it, from
    FIRST_EVALUATION on.

    Learning curves are read on a logarithmic axis of time, most of which would come before the first `every`.
    """
    halves = [every >> halved for halved in range(1, 5)]
    return [iteration for iteration in halves if iteration >= FIRST_EVALUATION]


def is_evaluated(iteration: int, every: int) -> bool:
    """Whether held-out views are evaluated then: each `every` iterations, and on a logarithmic grid before."""
    return iteration % every == 0 or iteration in early_evaluations(every)


def shortened(cfg: TrainConfig, share: float) -> TrainConfig:
    """The whole schedule in `share` (0 to 1) of its iterations (pipeline/config/scaled.py). No time budget."""
    return replace(scaled(cfg, max(1, round(cfg.iterations * share)), share), time_budget_s=None)


def phase(clock: float, cfg: TrainConfig, extent: float, max_sh_degree: int, max_fourier_order: int) -> Phase:
    """The phase at `clock`. extent: as `learning_rates`."""
    fraction = min(1.0, clock / cfg.iterations)
    return Phase(
        clock,
        learning_rates(clock, cfg.iterations, cfg.lr, extent),
        highest_trained(clock, cfg.orders_at[:3], max_sh_degree),
        highest_trained(clock, cfg.orders_at[3:], max_fourier_order),
        cfg.resolution_scale * resolution(fraction, cfg.resolution_steps),
        densification=clock < cfg.densify.stop,
        sphere=clock <= SPHERE_FREEZE_AFTER,
        environment_map=clock <= MAP_UNTIL,
        depth_decay=math.exp(-fraction / DEPTH_DECAY),
    )


def learning_rates(clock: float, iterations: int, cfg: LearningRates, extent: float) -> dict[str, LearningRate]:
    """Learning rates of every field and of the environment map at `clock`, in a schedule of so many iterations.

    extent: world units; it multiplies the positional rates. The mean's columns are x, y, z, with log-linear decay, and
    t, constant as in the release or with the same decay.
    """
    fraction = min(1.0, clock / iterations)
    decay = cfg.final_factor ** max(0.0, (fraction - DECAY_START) / (1 - DECAY_START))
    everywhere = cfg.factor * decay
    xyz = log_linear(*MEAN_RATE, clock / (cfg.decay_iterations or iterations)) * extent * everywhere
    t = xyz if cfg.time_decay else MEAN_RATE[0] * extent * everywhere
    rotation, faster = ROTATION_RATE * everywhere, max(1.0, FULL_RATE_FROM / iterations)
    return {
        "mean": (xyz, xyz, xyz, t),
        "log_scale": (SCALE_RATE * everywhere,) * 4,
        "quat_left": rotation,
        "quat_right": rotation,
        "velocity": cfg.velocity * xyz,
        "opacity_logit": OPACITY_RATE * everywhere,
        "sh": tuple(rate * decay for rate in sh_learning_rates(cfg)),
        "weights": math.sqrt(faster) * log_linear(*WEIGHTS_RATE, fraction) * decay,
        "trajectories": faster * log_linear(*TRAJECTORY_RATE, fraction) * extent * decay,
        "environment": MAP_LEARNING_RATE * decay,
    }


def at_all_times(rates: dict[str, LearningRate]) -> dict[str, LearningRate]:
    """The rates where Gaussians share trajectories: they stay at all times, and have no velocity besides. Adam would
    shorten lifetimes however little they gain by it."""
    mean, scale = rates["mean"], rates["log_scale"]
    assert isinstance(mean, tuple) and isinstance(scale, tuple)
    return rates | {"mean": (*mean[:3], 0.0), "log_scale": (*scale[:3], 0.0), "velocity": 0.0}


def on_tracks(rates: dict[str, LearningRate]) -> dict[str, LearningRate]:
    """The rates where brief Gaussians follow tracks: which of them follow which is fixed."""
    return rates | {"weights": 0.0}


def sh_learning_rates(cfg: LearningRates) -> tuple[float, float, float, float]:
    """Rates of the coefficients that depend on neither view nor time, on view, on time, on both."""
    return (
        cfg.factor * DC_RATE,
        cfg.sh_rest,
        cfg.sh_rest if cfg.sh_time is None else cfg.sh_time,
        cfg.sh_rest if cfg.sh_view_time is None else cfg.sh_view_time,
    )


def log_linear(start: float, end: float, fraction: float) -> float:
    """start^(1-f) end^f with f clamped to [0, 1]; `start` if one of them is not positive."""
    if start <= 0 or end <= 0:
        return start
    f = min(max(fraction, 0.0), 1.0)
    return start ** (1.0 - f) * end**f


def highest_trained(clock: float, starts: list[int], highest: int) -> int:
    """The SH degree or Fourier order in training: `starts` has the clock values from which 1, 2, … are."""
    return min(highest, sum(clock >= start for start in starts))


def resolution(fraction: float, steps: list[ResolutionStep]) -> float:
    """Scale of the first step whose `until` has not passed; full size after the last."""
    for step in steps:
        if fraction < step.until or step.until == 1:
            return step.scale
    return 1.0
