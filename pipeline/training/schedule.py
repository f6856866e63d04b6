"""What changes as training goes on: learning rates, active coefficients, resolution (docs/method.md 2).

All of it is a function of the `clock`, the iteration as a float. A run with a time budget moves the clock faster
where the budget would end before the iterations do, so that decays still reach their end.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Union

from pipeline.config.train_schema import LearningRates, ResolutionStep, TrainConfig

LearningRate = Union[float, tuple[float, ...]]  # one for the field, or one a column


@dataclass(frozen=True)
class Phase:
    """What one iteration trains with."""

    clock: float  # how far the schedule is, in iterations
    lr: dict[str, LearningRate]  # by field, and of the environment map; sh: as rasterizer.adam.sh_adam_step
    sh_degree: int
    fourier_order: int
    resolution: float  # × the size the images were read at
    densification: bool  # are its statistics still collected
    sphere: bool  # is the background's sphere still trained (pipeline/model/sphere.py)
    environment_map: bool  # is the environment map (pipeline/model/environment_map.py)


def clock(iteration: int, train_seconds: float, cfg: TrainConfig) -> float:
    """How far the schedule is, in iterations; `iteration` itself unless a time budget is running out first."""
    if cfg.time_budget_s is None:
        return float(iteration)
    return max(float(iteration), cfg.iterations * min(1.0, train_seconds / cfg.time_budget_s))


def shortened(cfg: TrainConfig, share: float) -> TrainConfig:
    """The whole schedule in `share` (0 to 1) of its iterations: every point of it so much sooner.

    How often Gaussians are looked at stays: that is how many views a look needs. No time budget.
    """

    def sooner(iteration: int) -> int:
        return round(iteration * share)

    dense = cfg.densify
    return replace(
        cfg,
        iterations=max(1, sooner(cfg.iterations)),
        time_budget_s=None,
        sh_degree_every=sooner(cfg.sh_degree_every),
        fourier_at=[sooner(start) for start in cfg.fourier_at],
        sphere_freeze_after=sooner(cfg.sphere_freeze_after),
        envmap_until=sooner(cfg.envmap_until),
        lr=replace(cfg.lr, decay_iterations=max(1, sooner(cfg.lr.decay_iterations))),
        densify=replace(
            dense, start=sooner(dense.start), stop=sooner(dense.stop), prune_big_after=sooner(dense.prune_big_after)
        ),
    )


def phase(now: float, cfg: TrainConfig, extent: float, max_sh_degree: int, max_fourier_order: int) -> Phase:
    """The phase at clock `now`. extent: as `learning_rates`."""
    fraction = min(1.0, now / cfg.iterations)
    return Phase(
        now,
        learning_rates(now, fraction, cfg.lr, extent),
        sh_degree(now, cfg.sh_degree_every, max_sh_degree),
        fourier_order(now, cfg.fourier_at, max_fourier_order),
        cfg.resolution_scale * resolution(fraction, cfg.resolution_steps),
        densification=now < cfg.densify.stop,
        sphere=now <= cfg.sphere_freeze_after,
        environment_map=now <= cfg.envmap_until,
    )


def learning_rates(now: float, fraction: float, cfg: LearningRates, extent: float) -> dict[str, LearningRate]:
    """Learning rate of every field, and of the environment map, at clock `now`, `fraction` of the whole schedule done.

    extent: world units, which positional rates are multiplied by.
    The mean's columns are x, y, z (log-linear decay over `decay_iterations`) and t (constant, as the release).
    The unit of t's rate is the extent's too: the paper does not scale time.
    """
    decay = cfg.final_factor ** max(0.0, (fraction - cfg.decay_start) / (1 - cfg.decay_start))
    xyz = log_linear(cfg.mean, cfg.mean_final, now / cfg.decay_iterations) * extent * decay
    t = cfg.mean_time * extent * decay
    rotation = cfg.rotation * decay
    return {
        "mean": (xyz, xyz, xyz, t),
        "log_scale": (cfg.scale * decay,) * 4,
        "quat_left": rotation,
        "quat_right": rotation,
        "opacity_logit": cfg.opacity * decay,
        "sh": tuple(rate * decay for rate in sh_learning_rates(cfg)),
        "environment_map": cfg.environment_map * decay,
    }


def sh_learning_rates(cfg: LearningRates) -> tuple[float, float, float, float]:
    """Of coefficients of neither view nor time, of view, of time, of both."""
    return (
        cfg.sh_dc,
        cfg.sh_rest,
        cfg.sh_rest if cfg.sh_time is None else cfg.sh_time,
        cfg.sh_rest if cfg.sh_view_time is None else cfg.sh_view_time,
    )


def log_linear(start: float, end: float, fraction: float) -> float:
    """start^(1-f) end^f with f clipped to [0, 1]; a rate of zero stays zero."""
    if start <= 0 or end <= 0:
        return start
    f = min(max(fraction, 0.0), 1.0)
    return start ** (1.0 - f) * end**f


def sh_degree(now: float, every: int, highest: int) -> int:
    """Degree 0 at first, one more each `every` iterations; every = 0: all at once."""
    return highest if every <= 0 else min(highest, int(now // every))


def fourier_order(now: float, starts: list[int], highest: int) -> int:
    """Orders 1, 2 from the clock values in `starts`; an empty list: all at once."""
    return highest if not starts else min(highest, sum(now >= start for start in starts))


def resolution(fraction: float, steps: list[ResolutionStep]) -> float:
    """Scale of the first step whose `until` has not passed; full size after the last."""
    for step in steps:
        if fraction < step.until:
            return step.scale
    return 1.0
