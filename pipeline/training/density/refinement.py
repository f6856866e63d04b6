"""Changes of the set of Gaussians after an optimiser step: densification, pruning, opacity resets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from datasets.scene import Scene, View
from pipeline.config.random_streams import Stream, stream
from pipeline.config.schema import Config
from pipeline.training.density import densification, error_sampling, sensitivity_pruning, visibility_pruning
from pipeline.training.density.error_sampling import ErrorSampler
from pipeline.training.schedule import Phase
from pipeline.training.state import TrainState


@dataclass(frozen=True)
class RefinementViews:
    """The training views as refinement uses them."""

    scoring: Sequence[View]  # sensitivity and visibility are measured on these
    errors: ErrorSampler

    @classmethod
    def of(cls, scene: Scene) -> RefinementViews:
        return cls(sensitivity_pruning.scoring_views(scene), ErrorSampler(scene))


def refine(state: TrainState, phase: Phase, views: RefinementViews, scene: Scene, cfg: Config) -> list[dict]:
    """Densify, prune by sensitivity and visibility, add Gaussians by error and reset opacities, each when it is due.

    Returns the events as rows of log.jsonl.
    """
    events = []
    rules = cfg.train.densify
    if densification.due(state.iteration, phase.clock, rules):
        done = densification.densify(
            state.optimiser, state.statistics, phase.clock, rules, scene.extent,
            cfg.ablation.time_split, state.split_rng, phase.sphere,
        )  # fmt: skip
        state.reset_statistics()
        events.append({
            "event": "densify", "iteration": state.iteration, "cloned": done.cloned, "split": done.split,
            "pruned": done.pruned, "n_gaussians": done.total,
        })  # fmt: skip
    if sensitivity_pruning.due(state.iteration, phase.clock, cfg.train):
        rng = stream(cfg.seed, Stream.SENSITIVITY, state.iteration)
        sensitivity = sensitivity_pruning.image_sensitivity(
            state.model, views.scoring, scene, cfg, phase.resolution, rng, state.threads
        )
        pruned = sensitivity_pruning.prune_by_sensitivity(
            state.optimiser, sensitivity, rules.prune_sensitivity, all_scored=len(views.scoring) == len(scene.train)
        )
        state.reset_statistics()
        events.append({
            "event": "prune_sensitivity", "iteration": state.iteration, "pruned": pruned,
            "n_gaussians": len(state.model),
        })  # fmt: skip
    if visibility_pruning.due(state.iteration, phase.clock, cfg):
        visible = visibility_pruning.visibility(state.model, views.scoring, scene, cfg, phase.resolution, state.threads)
        pruned = visibility_pruning.prune_hidden(state.optimiser, visible, rules.prune_hidden)
        state.reset_statistics()
        events.append({
            "event": "prune_hidden", "iteration": state.iteration, "pruned": pruned, "n_gaussians": len(state.model),
        })  # fmt: skip
    # After pruning, which makes room below max_gaussians and would remove most of them at once.
    if cfg.ablation.add_by_error and error_sampling.due(state.iteration, phase.clock, cfg.train):
        events.append(_add_by_error(state, views.errors, cfg))
    if densification.opacity_reset_due(state.iteration, phase.clock, rules):
        densification.reset_opacity(state.optimiser, phase.sphere)
    return events


def _add_by_error(state: TrainState, sampler: ErrorSampler, cfg: Config) -> dict:
    """Add Gaussians where and when the error is, as many as the three limits of their number allow."""
    rules, sphere = cfg.train.densify, state.model.sphere
    present = len(state.model) if sphere is None else int((~sphere).sum())
    limits = (rules.error_points, int(rules.error_points_share * present), rules.max_gaussians - present)
    count, added = min(limits), 0
    if count > 0 and state.model.kind.dims == 4:
        rng = stream(cfg.seed, Stream.ERROR_POINTS, state.iteration)
        rows = sampler.draw(state.model, cfg, count, rng, state.threads)
        if rows is not None:
            added = len(rows["mean"])
            state.optimiser.append(rows)
            state.reset_statistics()
    return {"event": "add_by_error", "iteration": state.iteration, "added": added, "n_gaussians": len(state.model)}
