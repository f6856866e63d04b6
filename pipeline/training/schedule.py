"""What changes as training goes on: learning rates, active coefficients, resolution (docs/method.md 2).

All of it is a function of the `clock`, the iteration as a float. A run with a time budget moves the clock faster
where the budget would end before the iterations do, so that decays still reach their end.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Union

from pipeline.config.train_schema import RateConfig, ResolutionStep, TrainConfig

Rate = Union[float, tuple[float, ...]]  # one for the field, or one a column


@dataclass(frozen=True)
class Phase:
    """What one iteration trains with."""

    rates: dict[str, Rate]  # by field, and of the environment map; sh: as rasterizer.adam.sh_adam_step
    sh_degree: int
    fourier_order: int
    resolution: float  # × the size the images were read at
    sphere: bool  # is the background's sphere still trained (background.py)
    environment: bool  # is the environment map (environment.py)


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
        environment_until=sooner(cfg.environment_until),
        rate=replace(cfg.rate, decay_iterations=max(1, sooner(cfg.rate.decay_iterations))),
        densify=replace(
            dense, start=sooner(dense.start), stop=sooner(dense.stop), prune_big_after=sooner(dense.prune_big_after)
        ),
    )


def phase(now: float, cfg: TrainConfig, extent: float, max_sh_degree: int, max_fourier_order: int) -> Phase:
    """The phase at clock `now`. extent: as `rates`."""
    fraction = min(1.0, now / cfg.iterations)
    return Phase(
        rates(now, fraction, cfg.rate, extent),
        sh_degree(now, cfg.sh_degree_every, max_sh_degree),
        fourier_order(now, cfg.fourier_at, max_fourier_order),
        cfg.resolution_scale * resolution(fraction, cfg.resolution_steps),
        sphere=now <= cfg.sphere_freeze_after,
        environment=now <= cfg.environment_until,
    )


def rates(now: float, fraction: float, cfg: RateConfig, extent: float) -> dict[str, Rate]:
    """Learning rate of every field, and of the environment map, at clock `now`, `fraction` of the whole schedule done.

    extent: world units, which positional rates are multiplied by.
    The mean's columns are x, y, z (log-linear decay over `decay_iterations`) and t (constant, as the release).
    The unit of t's rate is the extent's too: the paper does not scale time.
    """
    decay = cfg.final_factor ** max(0.0, (fraction - cfg.hold) / (1 - cfg.hold))
    xyz = log_linear(cfg.mean, cfg.mean_final, now / cfg.decay_iterations) * extent * decay
    t = cfg.mean_time * extent * decay
    rotation = cfg.rotation * decay
    return {
        "mean": (xyz, xyz, xyz, t),
        "log_scale": (cfg.scale * decay,) * 4,
        "quat_left": rotation,
        "quat_right": rotation,
        "opacity_logit": cfg.opacity * decay,
        "sh": tuple(rate * decay for rate in sh_rates(cfg)),
        "environment": cfg.environment * decay,
    }


def sh_rates(cfg: RateConfig) -> tuple[float, float, float, float]:
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
