"""Changes of the set of Gaussians after an optimiser step: densification, pruning, opacity resets."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Protocol

from datasets.scene import Scene
from pipeline.config.schema import Config
from pipeline.training.density.densification import Densification, OpacityReset
from pipeline.training.density.error_guided import ErrorGuidedDensification
from pipeline.training.density.row_order import RowOrder
from pipeline.training.density.sensitivity_pruning import SensitivityPruning, scoring_views
from pipeline.training.density.track_linking import TrackLinking
from pipeline.training.density.trajectory_start import TrajectoryStart
from pipeline.training.schedule import Phase
from pipeline.training.state import TrainState


class Refiner(Protocol):
    """One way to change the set of Gaussians."""

    @property
    def event(self) -> str: ...  # its name in log.jsonl

    def due(self, iteration: int, clock: float) -> bool:
        """Whether it is applied after `iteration`. clock: position in the schedule (schedule.py)."""

    def apply(self, state: TrainState, phase: Phase) -> dict[str, int]:
        """Change the model of `state`, with its optimiser and statistics. Returns what log.jsonl records."""


def refiners(scene: Scene, cfg: Config) -> list[Refiner]:
    """Those of a schedule, in the order in which they are applied."""
    rules, views = cfg.train.densify, scoring_views(scene)
    found: list[Refiner] = [TrajectoryStart(cfg)] if cfg.train.motion == "trajectories" else []
    found += [Densification(rules, scene.extent, cfg.ablation.time_split), SensitivityPruning(scene, cfg, views)]
    if cfg.ablation.add_by_error:
        found.append(ErrorGuidedDensification(scene, cfg))
    if cfg.train.motion == "tracks" and cfg.ablation.shared_motion:
        found.append(TrackLinking(scene, cfg))
    return [*found, RowOrder(rules), OpacityReset(rules)]


def refine(state: TrainState, phase: Phase, refiners: Sequence[Refiner]) -> Iterator[dict]:
    """Apply the refiners that are due; their events, rows of log.jsonl."""
    for refiner in refiners:
        if refiner.due(state.iteration, phase.clock):
            counts = refiner.apply(state, phase)
            state.neighbours = None
            yield {
                "event": refiner.event, "iteration": state.iteration, **counts, "n_gaussians": len(state.model)
            }  # fmt: skip
