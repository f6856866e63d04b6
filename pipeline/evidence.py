"""What the training images say of each Gaussian: how much of them it makes, and from how many places it was seen.

Where one camera moves, a Gaussian that lives for a frame is seen in one image. It can stand at any depth along the
ray, move at any speed and have any colour from elsewhere: it is that image learnt by heart, and other views pay for it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from datasets.scene import Scene, View
from pipeline.config import Config
from pipeline.model import Model
from pipeline.optimiser import Adam
from pipeline.train_config import DensifyConfig, TrainConfig
from pipeline.views import camera_at, spread
from rasterizer import Frame, Gradients, Request

MOST_VIEWS = 400  # of many cameras that are asked each time


@dataclass(frozen=True)
class Evidence:
    """Over the blending weights w = α' T (SPEC 1) of each Gaussian, summed over the pixels of each view; (N,) each."""

    weight: Tensor  # Σ w over all views, pixels
    views: Tensor  # (Σ w)² / Σ w², the effective number of views: 1 if one view has all, V if V have as much; 0: unseen


def evidence(model: Model, views: Sequence[View], scene: Scene, cfg: Config, resolution: float, threads: int
             ) -> Evidence:
    """What `views` at `resolution` of their size say of `model`.

    The derivative of a sum of pixels by a Gaussian's colour is the sum of its weights, so that one backward pass a
    view gives them all. All are shown in grey: a black one's colour is clamped at zero and would have no derivative,
    though it hides what is behind it.
    """
    frame, first, second = Frame(threads=threads), torch.zeros(len(model)), torch.zeros(len(model))
    grey = replace(model.gaussians(), sh=torch.zeros(len(model), 1, 3))
    gradients = Gradients.zeros_like(grey)
    for view in views:
        camera = camera_at(view.camera, resolution)
        frame.render(grey, Request(camera, view.time, scene.duration, near=cfg.scene.near * scene.unit))
        gradients.views.clear()
        seen = frame.backward(gradients, d_color=torch.ones(3, camera.height, camera.width))
        rows, weight = seen.visible.long(), gradients.views[0].gradient[:, 0]
        first.index_add_(0, rows, weight)
        second.index_add_(0, rows, weight.square())
    return Evidence(first, first.square() / second.clamp(min=torch.finfo(second.dtype).tiny))


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


def prune_due(iteration: int, cfg: TrainConfig) -> bool:
    """Every `evidence_every` iterations, on after the last densification, but not so late that what is left has no
    time to make up for it."""
    rules = cfg.densify
    wanted = (rules.min_views > 0 or rules.leave_out > 0) and iteration > rules.start
    return wanted and iteration % rules.evidence_every == 0 and iteration + rules.evidence_every <= cfg.iterations


def least(weight: Tensor, share: float) -> Tensor:
    """(N,) bool: those of least weight that together have no more than `share` of all weight; ties by index."""
    order = torch.sort(weight.double(), stable=True)
    together = torch.cumsum(order.values, dim=0)
    few = torch.zeros(len(weight), dtype=torch.bool)
    few[order.indices] = together <= share * together[-1]
    return few


def prune_unproven(optimiser: Adam, found: Evidence, cfg: DensifyConfig, all_asked: bool = True) -> int:
    """Remove what fewer than `min_views` views have seen, and what makes least of them, together the share `leave_out`;
    but not the background's sphere. Returns how many.

    What no view has seen goes too if all were asked (all_asked), or else it may live between the moments that were.
    Nothing goes where that would leave nothing.
    """
    model = optimiser.model
    keep = found.views >= cfg.min_views
    if cfg.leave_out > 0:
        keep = keep & ~least(found.weight, cfg.leave_out)
    if not all_asked:
        keep = keep | (found.views == 0)
    if model.sphere is not None:
        keep = keep | model.sphere
    removed = int((~keep).sum())
    if removed == len(model):
        return 0
    if removed:
        optimiser.keep(keep)
    return removed
