"""A schedule in fewer or more iterations: every iteration number of it is scaled, its intervals are kept.

The intervals of densification, pruning and opacity resets are kept, because each needs the statistics of a number of
views; that of additions by error is, too, because only pruning removes those that fit single views. Background models
freeze after as many iterations.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from typing import Any

from pipeline.config.train_schema import TrainConfig

ITERATIONS = "train.iterations"


def scaled_keys(cfg: TrainConfig, share: float) -> dict[str, Any]:
    """Dotted key -> value of the iteration numbers of `cfg`, × share, without `train.iterations`."""

    def scaled(iteration: int) -> int:
        return round(iteration * share)

    decay = cfg.lr.decay_iterations
    return {
        "train.orders_at": [scaled(start) for start in cfg.orders_at],
        "train.lr.decay_iterations": decay and max(1, scaled(decay)),
        "train.densify.start": scaled(cfg.densify.start),
        "train.densify.stop": scaled(cfg.densify.stop),
    }


def scaled(cfg: TrainConfig, iterations: int, share: float, given: Collection[str] = ()) -> TrainConfig:
    """`cfg` in so many iterations, its iteration numbers × share, but for the dotted keys in `given`."""
    keys = {key: value for key, value in scaled_keys(cfg, share).items() if key not in given}

    def of(prefix: str) -> dict[str, Any]:
        names = {key.removeprefix(prefix): value for key, value in keys.items() if key.startswith(prefix)}
        return {name: value for name, value in names.items() if "." not in name}

    lr, densify = replace(cfg.lr, **of("train.lr.")), replace(cfg.densify, **of("train.densify."))
    return replace(cfg, iterations=iterations, lr=lr, densify=densify, **of("train."))
