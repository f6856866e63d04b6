"""The training objective: all of a schedule's losses, and their gradient by one training view."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import reduce

import torch
from torch import Tensor

from datasets.scene import Scene
from pipeline.config.schema import Config
from pipeline.model.model import Model
from pipeline.model.render import ImageGradient, backward, render
from pipeline.training.objective.dropout import without
from pipeline.training.objective.image_terms import image_terms
from pipeline.training.objective.model_terms import model_terms
from pipeline.training.objective.terms import DrawnView
from rasterizer import Gradients, Request, ViewGradient, engine_for


@dataclass(frozen=True)
class RenderedView:
    """Result of the forward and backward pass of one view."""

    loss: float
    image: Tensor  # (3, H, W)
    target: Tensor  # (3, H, W)
    gradient: ViewGradient  # of the batch's loss
    n_alive: int  # Gaussians with temporal marginal p(t) >= 0.05


class Objective:
    """The terms, and the rasterizer whose memory every view reuses."""

    def __init__(self, scene: Scene, cfg: Config, threads: int) -> None:
        self._scene, self._near = scene, cfg.scene.near * scene.unit
        self._rasterizer = engine_for(cfg.backend, threads)
        self._released_gradients = tuple(cfg.train.released_gradients)
        self._image_terms = image_terms(cfg.train, scene, threads)
        self._model_terms = model_terms(cfg.train.regularization, scene, threads, cfg.seed)

    def backward(
        self, model: Model, view: DrawnView, gradients: Gradients, d_environment_map: Tensor | None = None
    ) -> RenderedView:
        """Render a view and add the gradient of its share of the batch's loss, in place.

        d_environment_map: of the map's image; None: the map is not trained.
        """
        view = replace(view, target=view.target.to(self._rasterizer.device))
        target, shown = view.target, model if view.dropped is None else without(model, view.dropped)
        terms = [term for term in self._image_terms if term.outputs(target)]
        outputs = {output for term in terms for output in term.outputs(target)}
        rendered = render(self._rasterizer, shown, self._request(view, outputs))
        compared = view
        if target.mask is not None:  # outside it the target is what is rendered, so that SSIM's windows see no error
            compared = replace(
                view, target=replace(target, image=torch.where(target.mask, target.image, rendered.image))
            )
        found = reduce(ImageGradient.__add__, (term(rendered, compared) for term in terms))
        if target.mask is not None:
            found = found.inside(target.mask)
        gradient = backward(self._rasterizer, shown, rendered, found, gradients, d_environment_map)
        loss = found.loss
        for model_term in self._model_terms:
            loss += model_term.add(gradients, model, view)
        return RenderedView(loss, rendered.image, target.image, gradient, self._rasterizer.alive)

    def gradient_of(self, model: Model, view: DrawnView) -> Gradients:
        """That of one view alone; finite_checks finds the non-finite view with it."""
        alone = Gradients.zeros_like(model.gaussians())
        self.backward(model, view, alone)
        return alone

    def _request(self, view: DrawnView, outputs: set[str]) -> Request:
        target, scene = view.target, self._scene
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
