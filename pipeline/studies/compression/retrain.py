"""Training what is left once more: the last part of its own schedule, at the rates it had then.

What was left out made a little of every image, which the others can learn to make. Going back to the rates of an
earlier iteration (Renda, Frankle & Carbin 2020, "rewinding") does that better than going on with the last, small ones.
"""

from __future__ import annotations

from dataclasses import replace

from datasets.scene import Scene
from pipeline.config.schema import Config
from pipeline.model.model import Model
from pipeline.training.loop import EvaluateFn, train
from pipeline.training.run_log import unrecorded


def retrained(model: Model, scene: Scene, cfg: Config, share: float, evaluate: EvaluateFn) -> Model:
    """`model`, in place, after the last `share` (0 to 1) of the schedule `cfg.train`; no Gaussian is added or pruned.

    evaluate: called once, at the end. Adam starts anew.
    """
    steady = replace(cfg.train.densify, stop=0, prune_sensitivity=0.0)
    schedule = replace(
        cfg.train,
        densify=steady,
        time_budget_s=None,
        eval_every=cfg.train.iterations,
        checkpoint_every=cfg.train.iterations,
    )
    first = round(cfg.train.iterations * (1 - share))
    if first == cfg.train.iterations:
        return model
    with unrecorded() as run:
        return train(model, scene, replace(cfg, train=schedule, resume=False), run, evaluate, begin=first).model
