"""Retraining of a pruned model: the last part of its schedule, at the learning rates of that part.

The other Gaussians can take over the small contributions of the pruned ones. Rewinding to the learning rates of an
earlier iteration (Renda, Frankle & Carbin 2020) does that better than fine-tuning at the last, small ones.
"""

from __future__ import annotations

from dataclasses import replace

from datasets.scene import Scene
from pipeline.config.schema import Config
from pipeline.model.model import Model
from pipeline.training.loop import EvaluateFn, train
from pipeline.training.run_log import temporary_run
from pipeline.training.state import save, start


def retrain(model: Model, scene: Scene, cfg: Config, share: float, evaluate_fn: EvaluateFn) -> Model:
    """`model`, trained for the last `share` (0 to 1) of the schedule `cfg.train` with the same number of Gaussians.

    evaluate_fn: called once, at the end. Adam starts with zero moments.
    """
    fixed_count = replace(cfg.train.densify, stop=0, prune_sensitivity=0.0, prune_hidden=0.0, error_points=0)
    schedule = replace(
        cfg.train,
        densify=fixed_count,
        time_budget_s=None,
        eval_every=cfg.train.iterations,
        checkpoint_every=cfg.train.iterations,
    )
    first = round(cfg.train.iterations * (1 - share))
    if first == cfg.train.iterations:
        return model
    cfg = replace(cfg, train=schedule, resume=True)
    with temporary_run() as run:  # goes on from a checkpoint, as after an interruption
        state = start(model, scene, cfg, run)
        state.iteration = first
        save(state, run, keep_moments=True)
        return train(model, scene, cfg, run, evaluate_fn).model
