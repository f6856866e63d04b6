"""The steps of an iteration: draw a batch, render its views forward and backward, step Adam (docs/method.md 2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from datasets.scene import Scene
from pipeline.config.random_streams import Stream, stream
from pipeline.config.schema import Config
from pipeline.config.train_schema import RegularizationConfig
from pipeline.data.training_views import Target, TrainingViews
from pipeline.model.model import Model
from pipeline.model.render import Rendered, backward, render
from pipeline.model.sphere import trainable_rows
from pipeline.training import finite_checks
from pipeline.training.kernels import Kernels
from pipeline.training.objective.depth_loss import DepthGradient, sky_loss, sparse_depth_loss
from pipeline.training.objective.dropout import draw_dropped, short_lived, without
from pipeline.training.objective.flow_loss import flow_loss
from pipeline.training.objective.losses import view_loss
from pipeline.training.objective.marginal_jitter import draw_offsets
from pipeline.training.objective.regularization import add_regularization_gradients
from pipeline.training.objective.rigid_loss import NEIGHBOURS, RELEASED_NEIGHBOURS, RIGID_EVERY, add_rigid_gradient
from pipeline.training.objective.still_gaussians import hold_still
from pipeline.training.schedule import Phase
from pipeline.training.state import TrainState
from rasterizer import Gradients, Request, ViewGradient


@dataclass(frozen=True)
class DrawnView:
    """A training view of a batch, and what is drawn for it."""

    target: Target
    dropped: Tensor | None = None  # (N,) bool, Gaussians that are left out of it; None: none
    rigid: bool = False  # whether the rigid loss is added with this view, at its time
    marginal_offset: float = 0.0  # its temporal marginals are those of its time + this


@dataclass(frozen=True)
class RenderedView:
    """Result of the forward and backward pass of one view."""

    loss: float
    image: Tensor  # (3, H, W)
    target: Tensor  # (3, H, W)
    gradient: ViewGradient  # of the batch's loss


class Batch:
    """Sums over the views of a batch; call `backward` once for each view."""

    last: RenderedView  # of the last call of `backward`, for the progress bar

    def __init__(self, model: Model, scene: Scene, cfg: Config, kernels: Kernels, phase: Phase, size: int) -> None:
        self._model, self._scene, self._cfg, self._kernels = model, scene, cfg, kernels
        self._phase, self._size = phase, size
        sparse = cfg.train.optimiser == "sparse_adam"
        self.visible = torch.zeros(len(model), dtype=torch.uint8) if sparse else None  # in any view; for sparse Adam
        environment_map = model.environment_map if phase.environment_map else None
        self.d_environment_map = None if environment_map is None else torch.zeros_like(environment_map.image)
        self.loss = 0.0  # mean over the batch
        self.n_gaussians = len(model)  # before refinement
        self.n_alive = 0.0  # Gaussians with temporal marginal p(t) >= 0.05, mean over the batch

    def backward(self, view: DrawnView, gradients: Gradients) -> RenderedView:
        """Render a view and add the gradient of its share of the batch's loss to `gradients`."""
        model = self._model if view.dropped is None else without(self._model, view.dropped)
        scene, cfg, rasterizer, target = self._scene, self._cfg, self._kernels.rasterizer, view.target
        request = Request(
            target.camera,
            target.time,
            scene.duration,
            scene.background,
            outputs=("color", *self._also(target)),
            flow_dt=None if target.motion is None else target.motion.step,
            flow_camera=None if target.motion is None else target.motion.camera,
            near=cfg.scene.near * scene.unit,
            sh_degree=self._phase.sh_degree,
            fourier_order=self._phase.fourier_order,
            marginal_offset=view.marginal_offset,
        )
        rendered = render(rasterizer, model, request)
        truth = target.image
        if target.mask is not None:  # a pixel that does not count has the colour that is rendered: no error
            truth = torch.where(target.mask, truth, rendered.image.detach())
        value = view_loss(self._kernels.criterion, rendered.image, truth, self._size)
        loss, d_image, d_flow = value.loss, value.d_image, None
        if target.mask is not None:  # the window of SSIM at a pixel that counts contains some that do not
            d_image = torch.where(target.mask, d_image, 0.0)
        if target.motion is not None and rendered.flow is not None:
            weight = cfg.train.regularization.flow
            part = None if target.motion.camera is None else rendered.alpha
            error, d_flow = flow_loss(rendered.flow, target.motion.flow, weight / self._size, part)
            loss += weight * error
        of_depth = self._depth_loss(rendered, target)
        d_alpha = d_depth = None
        if of_depth is not None:
            loss += of_depth.loss
            d_alpha, d_depth = of_depth.d_alpha / self._size, of_depth.d_depth / self._size
        gradient = backward(
            rasterizer, model, rendered, d_image, gradients, self.d_environment_map, d_flow, d_alpha, d_depth
        )
        if view.rigid:
            loss += self._add_rigid_gradient(target.time, gradients)
        if self.visible is not None:
            gradient.mark_visible(self.visible, self._kernels.threads)
        self.loss += loss / self._size
        self.n_alive += rasterizer.alive / self._size
        self.last = RenderedView(loss, rendered.image, target.image, gradient)
        return self.last

    def _also(self, target: Target) -> tuple[str, ...]:
        """The outputs that the losses of a view need besides its colour."""
        outputs = {"flow"} if target.motion is not None else set()
        if self._depth_weight(target) > 0 or self._needs_sky(target):
            outputs |= {"alpha", "depth"}
        if target.motion is not None and target.motion.camera is not None:
            outputs.add("alpha")
        return tuple(sorted(outputs))

    def _depth_weight(self, target: Target) -> float:
        weights = self._cfg.train.depth
        of_source = weights.lidar if self._scene.sweeps else weights.sfm
        return 0.0 if target.depth is None else of_source * self._phase.depth_decay

    def _needs_sky(self, target: Target) -> bool:
        return target.sky is not None and self._cfg.train.depth.sky_inverse > 0

    def _depth_loss(self, rendered: Rendered, target: Target) -> DepthGradient | None:
        """The losses on depth and sky of one view; None without any."""
        if rendered.depth is None or rendered.alpha is None:
            return None
        found = None
        if (weight := self._depth_weight(target)) > 0 and target.depth is not None:
            found = sparse_depth_loss(rendered.depth, rendered.alpha, target.depth, weight)
        if self._needs_sky(target) and target.sky is not None:
            of_sky = sky_loss(rendered.depth, rendered.alpha, target.sky, self._cfg.train.depth.sky_inverse)
            found = of_sky if found is None else found + of_sky
        return found

    def gradients_of(self, view: DrawnView) -> Gradients:
        """The gradient of one view alone; finite_checks finds the non-finite view with it."""
        alone = Gradients.zeros_like(self._model.gaussians())
        self.backward(view, alone)
        return alone

    def _add_rigid_gradient(self, time: float, gradients: Gradients) -> float:
        cfg, threads = self._cfg.train.regularization, self._kernels.threads
        if cfg.rigid_released:  # one view has it for all
            weight, moment, neighbours = cfg.rigid, None, RELEASED_NEIGHBOURS
        else:
            weight, moment, neighbours = cfg.rigid * RIGID_EVERY / self._size, time, NEIGHBOURS  # as in every view
        return self._size * add_rigid_gradient(
            gradients, self._model, moment, self._scene.duration, neighbours, weight, threads
        )


def draw_batch(state: TrainState, views: TrainingViews, phase: Phase, scene: Scene, cfg: Config) -> list[DrawnView]:
    """The views of the next iteration at the phase's resolution, each with what is drawn for it."""
    drawn = [DrawnView(views.at(index, phase.resolution)) for index in state.sampler.next_batch()]
    if phase.dropout > 0:
        rng = stream(cfg.seed, Stream.DROPOUT, state.iteration)
        may_drop = torch.tensor(True)
        if phase.dropout_lifetime is not None:
            may_drop = short_lived(state.model, phase.dropout_lifetime * scene.duration)
        drawn = [replace(view, dropped=draw_dropped(len(state.model), phase.dropout, rng) & may_drop) for view in drawn]
    if (jitter := cfg.train.marginal_jitter) > 0 and state.model.kind.moves:
        rng = stream(cfg.seed, Stream.MARGINAL, state.iteration)
        offsets = draw_offsets(len(drawn), jitter, state.model, scene, rng)
        drawn = [replace(view, marginal_offset=offset) for view, offset in zip(drawn, offsets, strict=True)]
    rules = cfg.train.regularization
    if rules.rigid > 0 and state.model.kind.moves:
        if rules.rigid_released:  # it is the same for all views
            return [replace(drawn[0], rigid=True), *drawn[1:]]
        before = (state.iteration - 1) * len(drawn)  # training views
        drawn = [replace(view, rigid=(before + i) % RIGID_EVERY == 0) for i, view in enumerate(drawn, 1)]
    return drawn


def render_batch(state: TrainState, drawn: Sequence[DrawnView], phase: Phase, scene: Scene, cfg: Config) -> Batch:
    """Forward and backward pass of every view; gradients and densification statistics accumulate in `state`.

    Raises finite_checks.NonFiniteError, which names the view, for a loss or a gradient that is not finite.
    """
    batch = Batch(state.model, scene, cfg, state.kernels, phase, len(drawn))
    state.zero_gradients()
    if phase.densification:
        state.statistics.begin()
    for view in drawn:
        rendered = batch.backward(view, state.gradients)
        finite_checks.check_loss(rendered.loss, state.iteration, view.target.name, state.model)
        if phase.densification:
            state.statistics.add_view(rendered.gradient, view.target.camera, scene.duration, state.threads)
    if phase.densification:
        state.statistics.end(len(drawn))
    finite_checks.check_gradients(
        state.gradients,
        state.iteration,
        [view.target.name for view in drawn],
        lambda index: batch.gradients_of(drawn[index]),
        state.threads,
    )
    return batch


def optimiser_step(
    state: TrainState, batch: Batch, phase: Phase, scene: Scene, regularization: RegularizationConfig
) -> None:
    """Add the gradients of the regularization, do one step of Adam, and hold long-lived Gaussians still.

    regularization: of `relative_to_data`.
    """
    add_regularization_gradients(state.gradients, state.model, regularization, scene)
    rows = trainable_rows(state.model, phase.sphere, batch.visible)
    state.optimiser.step(state.gradients, phase.lr, rows, batch.d_environment_map)
    if regularization.still_lifetime > 0 and state.model.kind.moves:
        hold_still(state.model, regularization.still_lifetime * scene.duration)
