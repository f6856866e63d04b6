"""Leaving out the Gaussians that the training images would miss least.

A pixel C is affine in each opacity o (docs/method.md 1.3; but for its cut-offs), so that without a Gaussian it changes
by exactly -o ∂C/∂o. Summed over the pixels of the training views the squares of that are the error which leaving it out
makes: little for what is hidden, faint or of the colour of what stands behind it, however much of the image it makes.

One backward pass with an image s gives Σ s o ∂C/∂o of every Gaussian. With random signs for s the square of that is the
sum of the squares on average (the diagonal of JᵀJ as Bekas, Kokiopoulou & Saad 2007 estimate one), so that a draw a
view will do.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

import numpy as np
import torch
from torch import Tensor

from datasets.scene import Scene, View
from pipeline.config.schema import Config
from pipeline.config.train_schema import TrainConfig
from pipeline.data.training_views import camera_at, spread
from pipeline.model.model import Model
from pipeline.model.render import backward, render
from pipeline.training.optimiser import Adam
from rasterizer import Frame, Gradients, Request

MOST_VIEWS = 400  # of many cameras that are asked each time
OPAQUE = 0.98  # what is more opaque counts as this: at α = 0.99 blending is clamped and has no derivative


def missed(
    model: Model,
    views: Iterable[View],
    scene: Scene,
    cfg: Config,
    resolution: float,
    generator: np.random.Generator,
    threads: int,
) -> Tensor:
    """(N,) by how much each Gaussian's absence alone would change the images of `views` at `resolution` of their size:
    the sum over pixels and channels of the squared change, estimated. 0: unseen. generator: of the signs.
    """
    frame, change = Frame(threads=threads), torch.zeros(len(model))
    limit = float(np.log(OPAQUE / (1 - OPAQUE)))
    asked = Model.restored(
        model.kind, {**model.state(), "opacity_logit": model.parameters["opacity_logit"].clamp(max=limit)}
    )
    gradients, transparency = Gradients.zeros_like(asked.gaussians()), torch.sigmoid(-asked.parameters["opacity_logit"])
    for view in views:
        request = Request(
            camera_at(view.camera, resolution),
            view.time,
            scene.duration,
            near=cfg.scene.near * scene.unit,
            background=scene.background,
        )
        shown = render(frame, asked, request)
        signs = 2.0 * torch.from_numpy(generator.integers(0, 2, tuple(shown.image.shape), dtype=np.int8)) - 1.0
        gradients.zero_(threads)
        gradients.views.clear()
        rows = backward(frame, asked, shown, signs, gradients).visible.long()
        # ∂/∂logit = o (1 - o) ∂/∂o
        change.index_add_(0, rows, (gradients.opacity_logit[rows] / transparency[rows]).square())
    return change


def views_to_ask(scene: Scene) -> list[View]:
    """All training views; where several cameras film each moment and that is many, those of moments spread evenly.

    Whole moments, for what lives between two of them is seen from as many places as there are cameras.
    """
    cameras = Counter(view.time for view in scene.train)
    if len(scene.train) <= MOST_VIEWS or min(cameras.values()) < 2:
        return list(scene.train)
    times = sorted(cameras)
    chosen = {times[i] for i in spread(len(times), max(1, MOST_VIEWS * len(times) // len(scene.train)))}
    return [view for view in scene.train if view.time in chosen]


def due(iteration: int, cfg: TrainConfig) -> bool:
    """Every `leave_out_every` iterations, on after the last densification, but not so late that what is left has no
    time to make up for it."""
    rules = cfg.densify
    return (
        rules.leave_out > 0
        and iteration > rules.start
        and iteration % rules.leave_out_every == 0
        and iteration + rules.leave_out_every <= cfg.iterations
    )


def least(worth: Tensor, share: float) -> Tensor:
    """(N,) bool: those worth least that together have no more than `share` of what all are worth; ties by index."""
    order = torch.sort(worth.double(), stable=True)
    together = torch.cumsum(order.values, dim=0)
    few = torch.zeros(len(worth), dtype=torch.bool)
    few[order.indices] = together <= share * together[-1]
    return few


def leave_out(optimiser: Adam, change: Tensor, share: float, all_asked: bool = True) -> int:
    """Remove what is missed least, together `share` of the (N,) `change` of all that may go. Returns how many.

    The background's sphere may not. What no view has seen goes if all were asked (all_asked), or else it may live
    between the moments that were. Nothing goes where that would leave nothing.
    """
    model, may_go = optimiser.model, torch.ones_like(change, dtype=torch.bool)
    if not all_asked:
        may_go &= change > 0
    if model.sphere is not None:
        may_go &= ~model.sphere
    gone = may_go & least(change * may_go, share)
    removed = int(gone.sum())
    if removed == len(model):
        return 0
    if removed:
        optimiser.keep(~gone)
    return removed
