"""Pruning by visibility: Gaussians that others hide in every training view are removed.

No image determines what is behind an opaque surface. Gaussians there show through it a little, and fill in for what
dropout leaves out. A camera on another side sees them whole.

The visibility of a Gaussian in a view is Σ α' T / Σ α' over the pixels: the share of it that reaches the camera. The
numerator is the derivative of the sum of all pixels by its colour. The denominator has a closed form.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from datasets.scene import Scene, View
from pipeline.config.schema import Config
from pipeline.data.training_views import camera_at
from pipeline.model.model import Model
from pipeline.training.density.densification import remove
from pipeline.training.density.sensitivity_pruning import scheduled
from pipeline.training.optimiser import Adam
from pipeline.training.schedule import Phase
from pipeline.training.state import TrainState
from rasterizer import Gradients, Rasterizer, Request

SCALE = 0.5  # × the resolution that is trained at: for run time
MIN_UNOCCLUDED = 0.1  # Σ α' of a Gaussian in a view: with less it has too few pixels


class VisibilityPruning:
    """In the iterations of pruning by sensitivity, after it."""

    event = "prune_hidden"

    def __init__(self, scene: Scene, cfg: Config, views: Sequence[View]) -> None:
        """views: the scoring views."""
        self._scene, self._cfg, self._views = scene, cfg, views
        self._least = cfg.train.densify.prune_hidden

    def due(self, iteration: int, clock: float) -> bool:
        return self._least > 0 and scheduled(iteration, clock, self._cfg.train)

    def apply(self, state: TrainState, phase: Phase) -> dict[str, int]:
        visible = visibility(state.model, self._views, self._scene, self._cfg, phase.resolution, state.threads)
        pruned = prune_hidden(state.optimiser, visible, self._least)
        state.reset_statistics()
        return {"pruned": pruned}


def visibility(
    model: Model, views: Sequence[View], scene: Scene, cfg: Config, resolution: float, threads: int
) -> Tensor:
    """(N,) the largest visibility in any of `views`, about 0 to 1; 1 where no view observes it.

    resolution: × the size of the views. All Gaussians are rendered grey: a black one's colour is clamped at zero and
    would have no derivative.
    """
    grey = replace(model.gaussians(), sh=torch.zeros(len(model), 1, 3))
    gradients, rasterizer = Gradients.zeros_like(grey), Rasterizer(threads=threads)
    largest, known = torch.zeros(len(model)), torch.zeros(len(model), dtype=torch.bool)
    for view in views:
        camera = camera_at(view.camera, SCALE * resolution)
        rasterizer.render(grey, Request(camera, view.time, scene.duration, near=cfg.scene.near * scene.unit))
        gradients.views.clear()
        seen = rasterizer.backward(gradients, d_color=torch.ones(3, camera.height, camera.width))
        observed = seen.unoccluded > MIN_UNOCCLUDED
        rows, unoccluded = seen.visible[observed].long(), seen.unoccluded[observed]
        weight = gradients.views[0].gradient[observed, 0]
        largest[rows] = torch.maximum(largest[rows], weight / unoccluded)
        known[rows] = True
    return torch.where(known, largest, 1.0)


def prune_hidden(optimiser: Adam, visible: Tensor, least: float) -> int:
    """Remove the Gaussians with `visible` (N,) < `least`, except for the sphere around the scene. Returns how many.

    A pruning of all Gaussians is skipped.
    """
    model, hidden = optimiser.model, visible < least
    if model.sphere is not None:
        hidden &= ~model.sphere
    return remove(optimiser, hidden)
