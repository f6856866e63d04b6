"""Changes of the set of Gaussians after an optimiser step: densification, pruning by sensitivity, opacity resets."""

from __future__ import annotations

from collections.abc import Sequence

from datasets.scene import Scene, View
from pipeline.config.random_streams import Stream, stream
from pipeline.config.schema import Config
from pipeline.training.density import densification, sensitivity_pruning
from pipeline.training.schedule import Phase
from pipeline.training.state import TrainState


def refine(state: TrainState, phase: Phase, scoring: Sequence[View], scene: Scene, cfg: Config) -> list[dict]:
    """Densify, prune by sensitivity and reset opacities in the iterations scheduled for it. Returns the events as rows
    of log.jsonl. scoring: the views that sensitivity is measured on."""
    events = []
    rules = cfg.train.densify
    if densification.due(state.iteration, phase.clock, rules):
        done = densification.densify(
            state.optimiser, state.statistics, state.iteration, rules, scene.extent,
            cfg.ablation.time_split, state.split_rng, phase.sphere,
        )  # fmt: skip
        state.reset_statistics()
        events.append({
            "event": "densify", "iteration": state.iteration, "cloned": done.cloned, "split": done.split,
            "pruned": done.pruned, "n_gaussians": done.total,
        })  # fmt: skip
    if sensitivity_pruning.due(state.iteration, cfg.train):
        rng = stream(cfg.seed, Stream.SENSITIVITY, state.iteration)
        sensitivity = sensitivity_pruning.image_sensitivity(
            state.model, scoring, scene, cfg, phase.resolution, rng, state.threads
        )
        pruned = sensitivity_pruning.prune_by_sensitivity(
            state.optimiser, sensitivity, rules.prune_sensitivity, all_scored=len(scoring) == len(scene.train)
        )
        state.reset_statistics()
        events.append({
            "event": "prune_sensitivity", "iteration": state.iteration, "pruned": pruned,
            "n_gaussians": len(state.model),
        })  # fmt: skip
    if densification.opacity_reset_due(state.iteration, phase.clock, rules):
        densification.reset_opacity(state.optimiser, rules, phase.sphere)
    return events
