"""The indicators of densification: gradients of the projected mean and of the mean in time, averaged over views."""

from __future__ import annotations

from functools import partial

import torch
from torch import Tensor

from pipeline.model.model import CPU
from rasterizer import Camera, ViewGradient


class Statistics:
    """Running means of the two indicators of each Gaussian since the last densification.

    Within an iteration an indicator is the mean over the views in which the Gaussian is visible, of the gradient of one
    view's loss (docs/method.md 2: Σ over the batch × B / visible views, because the batch loss is a mean over B). Over
    iterations it is the mean over those in which the Gaussian was visible. Per iteration call `begin`, `add_view` for
    each view, then `end`.
    """

    FIELDS = ("space", "time", "iterations")

    def __init__(self, count: int, device: torch.device = CPU) -> None:
        zeros = partial(torch.zeros, count, device=device)
        self.space = zeros()  # Σ over iterations, NDC units
        self.time = zeros()  # Σ over iterations, per duration
        self.iterations = zeros()  # iterations with at least one view that shows it
        self._space = zeros()  # the same within the current iteration
        self._time = zeros()
        self._views = zeros()

    def begin(self) -> None:
        for tensor in (self._space, self._time, self._views):
            tensor.zero_()

    def add_view(
        self,
        view: ViewGradient,  # of the batch's loss
        camera: Camera,  # of that view; the gradient is in its pixels
        duration: float,
        threads: int = 1,
    ) -> None:
        """Accumulate the backward pass of one view. duration: of the scene."""
        view.accumulate(self._space, self._time, self._views, camera, duration, threads)

    def end(self, batch: int) -> None:
        """Add the iteration's `batch` views to the running sums."""
        scale = self._views.clamp(min=1).reciprocal_().mul_(batch)  # invisible Gaussians have zero sums
        self.space.addcmul_(self._space, scale)
        self.time.addcmul_(self._time, scale)
        self.iterations += self._views.clamp_(max=1)

    def indicators(self) -> tuple[Tensor, Tensor]:
        """Mean (space, time) indicators, (N,) each, in NDC units and per duration; 0 for Gaussians never visible."""
        count = self.iterations.clamp(min=1)
        return self.space / count, self.time / count

    def reorder(self, rows: Tensor) -> None:
        """Between iterations: the Gaussians are now those `rows`, indices of all present ones."""
        for name in self.FIELDS:
            setattr(self, name, getattr(self, name)[rows])

    def state(self) -> dict[str, Tensor]:
        return {name: getattr(self, name) for name in self.FIELDS}

    @classmethod
    def restored(cls, state: dict[str, Tensor], device: torch.device = CPU) -> Statistics:
        statistics = cls(len(state["space"]), device)
        for name in cls.FIELDS:
            getattr(statistics, name).copy_(state[name])
        return statistics
