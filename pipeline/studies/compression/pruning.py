"""Pruning of a trained model by image sensitivity, and retraining for the last part of its schedule.

The other Gaussians can take over the small contributions of the pruned ones. Rewinding to the learning rates of an
earlier iteration (Renda, Frankle & Carbin 2020) does that better than fine-tuning at the last, small ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from datasets.scene import Scene
from pipeline.config.random_streams import Stream, stream
from pipeline.config.schema import Config
from pipeline.evaluation.quick_evaluate import quick_evaluate
from pipeline.model.model import GLOBAL_TENSORS, Model
from pipeline.trained.open_run import TrainedRun
from pipeline.training.density.sensitivity_pruning import image_sensitivity
from pipeline.training.loop import EvaluateFn, train
from pipeline.training.reporting import temporary_run
from pipeline.training.state import save, start
from rasterizer import Rasterizer
from rasterizer.cores import thread_count


def pruned_models(run: TrainedRun, fractions: Sequence[float], share: float) -> dict[float, Model]:
    """The model of a run by the fraction of its Gaussians kept: all of them, then each of `fractions`.

    share: part of the schedule for which a pruned model is retrained.
    """
    model, scene, cfg, threads = run.model, run.scene, run.cfg, thread_count(run.cfg.threads)
    rng, rasterizer = stream(cfg.seed, Stream.SENSITIVITY), Rasterizer(threads=threads)
    sensitivity = image_sensitivity(model, scene.train, scene, cfg, cfg.train.resolution_scale, rng, threads)
    models = {1.0: model}
    for fraction in fractions:
        pruned = prune_by_sensitivity(model, sensitivity, fraction)
        models[fraction] = retrain(
            pruned, scene, cfg, share, lambda state, progress: quick_evaluate(state, scene, cfg, rasterizer)
        )
    return models


def prune_by_sensitivity(model: Model, sensitivity: Tensor, keep: float) -> Model:
    """A model of the fraction `keep` (0 to 1) of the Gaussians with the largest `sensitivity` (N,), in their order.

    At least one is kept. Of equal sensitivities the lower index is kept. The model given stays as it is.
    """
    count = max(1, round(keep * len(model)))
    kept = torch.sort(sensitivity, descending=True, stable=True).indices[:count].sort().values
    state = {name: tensor if name in GLOBAL_TENSORS else tensor[kept] for name, tensor in model.state().items()}
    return Model.restored(model.kind, state)


def retrain(model: Model, scene: Scene, cfg: Config, share: float, evaluate_fn: EvaluateFn) -> Model:
    """`model`, trained for the last `share` (0 to 1) of the schedule `cfg.train` with the same number of Gaussians.

    evaluate_fn: called once, at the end. Adam starts with zero moments.
    """
    iterations = cfg.train.iterations
    first = round(iterations * (1 - share))
    if first == iterations:
        return model
    fixed_count = replace(cfg.train.densify, stop=0, prune_sensitivity=0.0, add_by_error=0.0)
    schedule = replace(
        cfg.train, densify=fixed_count, time_budget_s=None, eval_every=iterations, checkpoint_every=iterations
    )
    cfg = replace(cfg, train=schedule, resume=True)
    with temporary_run() as run:  # goes on from a checkpoint, as after an interruption
        state = start(model, scene, cfg, run)
        state.iteration = first
        save(state, run)
        return train(model, scene, cfg, run, evaluate_fn).model
