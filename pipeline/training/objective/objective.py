"""The training objective: all of a schedule's losses, and their gradient by one training view."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce

import torch
from torch import Tensor

from datasets.scene import Scene
from pipeline.config.schema import Config
from pipeline.model.model import Model
from pipeline.model.render import ImageGradient, Rendered, backward, render_views
from pipeline.training.objective.image_terms import image_terms
from pipeline.training.objective.model_terms import model_terms
from pipeline.training.objective.terms import DrawnView
from rasterizer import Engine, Gradients, Request, ViewGradient, engine_for


@dataclass(frozen=True)
class ForwardPass:
    """A view of a batch after its forward pass: what its backward pass needs."""

    view: DrawnView  # on the rasterizer's device
    rasterizer: Engine
    rendered: Rendered


@dataclass(frozen=True)
class RenderedView:
    """Result of the forward and backward pass of one view."""

    loss: float
    image: Tensor  # (3, H, W)
    target: Tensor  # (3, H, W)
    gradient: ViewGradient  # of the batch's loss
    n_alive: int  # Gaussians with temporal marginal p(t) >= 0.05


class Objective:
    """The terms, and a rasterizer for each view of a batch, whose memory every batch reuses."""

    def __init__(self, scene: Scene, cfg: Config, threads: int) -> None:
        self._scene, self._near = scene, cfg.scene.near * scene.unit
        self._rasterizers = [engine_for(cfg.backend, threads) for _ in range(cfg.train.batch)]
        self._released_gradients = tuple(cfg.train.released_gradients)
        self._image_terms = image_terms(cfg.train, scene, threads)
        self._model_terms = model_terms(cfg.train.regularization, scene, threads, cfg.seed)

    def render(self, model: Model, views: Sequence[DrawnView]) -> list[ForwardPass]:
        """The forward pass of a batch's views; the next one replaces it."""
        rasterizers = self._rasterizers[: len(views)]
        views = [replace(view, target=view.target.to(rasterizers[0].device)) for view in views]
        rendered = render_views(rasterizers, model, [self._request(view) for view in views])
        return [ForwardPass(*each) for each in zip(views, rasterizers, rendered, strict=True)]

    def backward(
        self, model: Model, found: ForwardPass, gradients: Gradients, d_environment_map: Tensor | None = None
    ) -> RenderedView:
        """Add the gradient of a view's share of the batch's loss, in place.

        d_environment_map: of the map's image; None: the map is not trained.
        """
        view, rendered, target = found.view, found.rendered, found.view.target
        compared = view
        if target.mask is not None:  # outside it the target is what is rendered, so that SSIM's windows see no error
            compared = replace(
                view, target=replace(target, image=torch.where(target.mask, target.image, rendered.image))
            )
        terms = [term for term in self._image_terms if term.outputs(target)]
        by_image = reduce(ImageGradient.__add__, (term(rendered, compared) for term in terms))
        if target.mask is not None:
            by_image = by_image.inside(target.mask)
        gradient = backward(found.rasterizer, model, rendered, by_image, gradients, d_environment_map)
        loss = by_image.loss
        for model_term in self._model_terms:
            loss += model_term.add(gradients, model, view)
        return RenderedView(loss, rendered.image, target.image, gradient, found.rasterizer.alive)

    def gradient_of(self, model: Model, view: DrawnView) -> Gradients:
        """That of one view alone; finite_checks finds the non-finite view with it."""
        alone = Gradients.zeros_like(model.gaussians())
        (found,) = self.render(model, [view])
        self.backward(model, found, alone)
        return alone

    def _request(self, view: DrawnView) -> Request:
        target, scene = view.target, self._scene
        outputs = {output for term in self._image_terms for output in term.outputs(target)}
        return Request(
            target.camera,
            target.time,
            scene.duration,
            scene.background,
            outputs=sorted(outputs),
            flow_dt=None if target.motion is None else target.motion.step,
            flow_camera=None if target.motion is None else target.motion.camera,
            near=self._near,
            sh_degree=view.phase.sh_degree,
            fourier_order=view.phase.fourier_order,
            marginal_offset=view.marginal_offset,
            released_gradients=self._released_gradients,
        )
