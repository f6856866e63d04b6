"""The steps of an iteration: draw a batch, render its views forward and backward, step Adam (docs/method.md 2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from datasets.scene import Scene
from pipeline.config.random_streams import Stream, stream
from pipeline.config.schema import Config
from pipeline.data.training_views import TrainingViews
from pipeline.model.sphere import trainable_rows
from pipeline.training import finite_checks
from pipeline.training.objective.marginal_jitter import draw_offsets
from pipeline.training.objective.objective import Objective, RenderedView
from pipeline.training.objective.still_gaussians import hold_still
from pipeline.training.objective.terms import DrawnView
from pipeline.training.schedule import Phase
from pipeline.training.state import TrainState


@dataclass
class Batch:
    """Sums over the views of a batch."""

    n_gaussians: int  # before refinement
    visible: Tensor | None  # (N,) uint8, in any view; for sparse Adam
    d_environment_map: Tensor | None  # None: there is none, or it is not trained
    loss: float = 0.0  # mean over the views
    n_alive: float = 0.0  # Gaussians with temporal marginal p(t) >= 0.05, mean over the views
    last: RenderedView | None = None  # for the progress bar

    def add(self, view: RenderedView, views: int, threads: int) -> None:
        if self.visible is not None:
            view.gradient.mark_visible(self.visible, threads)
        self.loss += view.loss / views
        self.n_alive += view.n_alive / views
        self.last = view


def draw_batch(state: TrainState, views: TrainingViews, phase: Phase, scene: Scene, cfg: Config) -> list[DrawnView]:
    """The views of the next iteration at the phase's resolution, each with what is drawn for it."""
    chosen = state.sampler.next_batch()
    before = (state.iteration - 1) * len(chosen)
    drawn = [
        DrawnView(views.at(index, phase.resolution), phase, len(chosen), place, before + place + 1)
        for place, index in enumerate(chosen)
    ]
    drawn[0] = replace(drawn[0], neighbours=state.neighbours)
    if (jitter := cfg.train.marginal_jitter) > 0 and state.model.kind.moves:
        rng = stream(cfg.seed, Stream.MARGINAL, state.iteration)
        offsets = draw_offsets(len(drawn), jitter, state.model, scene, rng)
        drawn = [replace(view, marginal_offset=offset) for view, offset in zip(drawn, offsets, strict=True)]
    return drawn


def render_batch(
    state: TrainState, drawn: Sequence[DrawnView], phase: Phase, objective: Objective, scene: Scene, cfg: Config
) -> Batch:
    """Forward and backward pass of every view; gradients and densification statistics accumulate in `state`.

    Raises finite_checks.NonFiniteError, which names the view, for a loss or a gradient that is not finite.
    """
    model, count = state.model, len(state.model)
    sparse = cfg.train.optimiser == "sparse_adam"
    visible = torch.zeros(count, dtype=torch.uint8, device=model.device) if sparse else None
    environment_map = model.environment_map if phase.environment_map else None
    batch = Batch(count, visible, None if environment_map is None else torch.zeros_like(environment_map.image))
    state.zero_gradients()
    if phase.densification:
        state.statistics.begin()
    for view, found in zip(drawn, objective.render(model, drawn), strict=True):
        rendered = objective.backward(model, found, state.gradients, batch.d_environment_map)
        batch.add(rendered, len(drawn), state.threads)
        finite_checks.check_loss(rendered.loss, state.iteration, view.target.name, model)
        if phase.densification:
            state.statistics.add_view(rendered.gradient, view.target.camera, scene.duration, state.threads)
    if phase.densification:
        state.statistics.end(len(drawn))
    finite_checks.check_gradients(
        state.gradients,
        state.iteration,
        [view.target.name for view in drawn],
        lambda index: objective.gradient_of(model, drawn[index]),
        state.threads,
    )
    return batch


def optimiser_step(state: TrainState, batch: Batch, phase: Phase, scene: Scene, cfg: Config) -> None:
    """Do one step of Adam, and hold long-lived Gaussians still."""
    rows = trainable_rows(state.model, phase.sphere, batch.visible)
    state.optimiser.step(state.gradients, phase.lr, rows, batch.d_environment_map)
    if (share := cfg.train.regularization.still_lifetime) > 0:
        hold_still(state.model, share * scene.duration)
