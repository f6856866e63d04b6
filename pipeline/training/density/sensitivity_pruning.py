"""Pruning by sensitivity: Gaussians whose removal changes the training images least are removed.

A pixel C is affine in each opacity o (docs/method.md 1.3, except for the cut-offs), so that removing a Gaussian changes
it by exactly -o ∂C/∂o. The sensitivity of a Gaussian is the sum of the squares of that over the pixels of the training
views. It is small for a Gaussian that is hidden, faint, or of the colour behind it.

One backward pass with an image s gives Σ s o ∂C/∂o of every Gaussian. With random signs s, the expectation of its
square is the sum of the squares: Hutchinson's estimate of the diagonal of JᵀJ (Bekas, Kokiopoulou & Saad 2007). One
sample per view is enough.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence

import numpy as np
import torch
from torch import Tensor

from datasets.scene import Scene, View
from pipeline.config.random_streams import Stream, stream
from pipeline.config.schema import Config
from pipeline.config.train_schema import TrainConfig
from pipeline.data.training_views import camera_at, evenly_spaced
from pipeline.model.model import Model
from pipeline.model.render import ImageGradient, backward, render_each
from pipeline.training.density.densification import remove
from pipeline.training.optimiser import Adam
from pipeline.training.schedule import Phase
from pipeline.training.state import TrainState
from rasterizer import Gradients, Request

MAX_VIEWS = 400  # scoring views, where several cameras see each time
OPAQUE = 0.98  # a higher opacity is taken as this: at α = 0.99 blending is clamped and has no derivative


class SensitivityPruning:
    event = "prune_sensitivity"

    def __init__(self, scene: Scene, cfg: Config, views: Sequence[View]) -> None:
        """views: the scoring views."""
        self._scene, self._cfg, self._views = scene, cfg, views
        self._share = cfg.train.densify.prune_sensitivity

    def due(self, iteration: int, clock: float) -> bool:
        return self._share > 0 and scheduled(iteration, clock, self._cfg.train)

    def apply(self, state: TrainState, phase: Phase) -> dict[str, int]:
        rng = stream(state.seed, Stream.SENSITIVITY, state.iteration)
        sensitivity = image_sensitivity(
            state.model, self._views, self._scene, self._cfg, phase.resolution, rng, state.threads
        )
        all_scored = len(self._views) == len(self._scene.train)
        pruned = prune_by_sensitivity(state.optimiser, sensitivity, self._share, all_scored)
        state.reset_statistics()
        return {"pruned": pruned}


def image_sensitivity(
    model: Model,
    views: Iterable[View],
    scene: Scene,
    cfg: Config,
    resolution: float,
    rng: np.random.Generator,
    threads: int,
) -> Tensor:
    """(N,) estimated squared change of the images of `views`, summed over pixels and channels, by removing each
    Gaussian alone; 0 for a Gaussian in none of the images. resolution: × the size of the views. rng: for the signs.
    """
    change = torch.zeros(len(model), device=model.device)
    limit = float(np.log(OPAQUE / (1 - OPAQUE)))
    logit = model.parameters["opacity_logit"].clamp(max=limit)
    clamped = model.with_parameters({**model.parameters, "opacity_logit": logit})
    gradients = Gradients.zeros_like(clamped.gaussians())
    transparency = torch.sigmoid(-clamped.parameters["opacity_logit"])
    near = cfg.scene.near * scene.unit
    requests = [
        Request(camera_at(view.camera, resolution), view.time, scene.duration, scene.background, near=near)
        for view in views
    ]
    for rasterizer, rendered in render_each(cfg.backend, threads, clamped, requests):
        coins = torch.from_numpy(rng.integers(0, 2, tuple(rendered.image.shape), dtype=np.int8))
        signs = 2.0 * coins.to(model.device) - 1.0
        gradients.zero_(threads)
        rows = backward(rasterizer, clamped, rendered, ImageGradient(image=signs), gradients).visible.long()
        # ∂/∂logit = o (1 - o) ∂/∂o
        change.index_add_(0, rows, (gradients.opacity_logit[rows] / transparency[rows]).square())
    return change


def scoring_views(scene: Scene) -> list[View]:
    """The views that sensitivity is measured on: all training views; or, with more than MAX_VIEWS and several cameras
    at each time, the views of evenly spread times.

    All views of a chosen time are used, so that its Gaussians are scored from every camera. Of videos that are not
    synchronised, the times within one frame spacing count as one.
    """
    if len(scene.train) <= MAX_VIEWS:
        return list(scene.train)
    moments = [view.time for view in scene.train]
    if min(Counter(moments).values()) < 2:
        if scene.frame_rate is None or not scene.several_cameras:
            return list(scene.train)
        moments = [(time - scene.time_start) // scene.frame_spacing for time in moments]
    times = sorted(set(moments))
    chosen = {times[i] for i in evenly_spaced(len(times), max(1, MAX_VIEWS * len(times) // len(scene.train)))}
    return [view for view, moment in zip(scene.train, moments) if moment in chosen]


def scheduled(iteration: int, clock: float, cfg: TrainConfig) -> bool:
    """Every `prune_sensitivity_every` iterations, also after the last densification, except for the last period, in
    which the remaining Gaussians could not adapt. clock: position in the schedule, in iterations, of which a time
    budget makes an iteration more than one."""
    rules = cfg.densify
    period = rules.prune_sensitivity_every * clock / max(1, iteration)
    return (
        iteration > rules.start and iteration % rules.prune_sensitivity_every == 0 and clock + period <= cfg.iterations
    )


def least_sensitive(sensitivity: Tensor, share: float) -> Tensor:
    """(N,) bool: the Gaussians of lowest sensitivity that together have at most `share` of the total; ties by index."""
    order = torch.sort(sensitivity.double(), stable=True)
    cumulative = torch.cumsum(order.values, dim=0)
    lowest = torch.zeros_like(sensitivity, dtype=torch.bool)
    lowest[order.indices] = cumulative <= share * cumulative[-1]
    return lowest


def prune_by_sensitivity(optimiser: Adam, sensitivity: Tensor, share: float, all_scored: bool = True) -> int:
    """Remove the Gaussians of lowest sensitivity, (N,), together at most `share` of the total. Returns how many.

    The sphere around the scene is kept. all_scored: every training view was a scoring view. If not, a Gaussian of
    sensitivity 0 is kept: it may be visible between the scoring views' times. A pruning of all Gaussians is skipped.
    """
    model, candidates = optimiser.model, torch.ones_like(sensitivity, dtype=torch.bool)
    if not all_scored:
        candidates &= sensitivity > 0
    if model.sphere is not None:
        candidates &= ~model.sphere
    pruned = candidates & least_sensitive(sensitivity * candidates, share)
    return remove(optimiser, pruned)
