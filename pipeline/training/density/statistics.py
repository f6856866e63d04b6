"""The two indicators of densification: gradients of the mean on the screen and in time, averaged over iterations."""

from __future__ import annotations

import torch
from torch import Tensor

from rasterizer import Camera, ViewGradient


class Statistics:
    """Running means of the two indicators, and the largest radius, of each Gaussian since the last densification.

    Within an iteration the indicator is the mean over the views that saw the Gaussian, of the loss of one view
    (docs/method.md 2: Σ over the batch × B / times seen, because the batch loss is a mean over B). Over iterations it
    is the mean over those in which it was seen at all. `begin`, `add_view` for each view, `end`.
    """

    FIELDS = ("space", "time", "iterations", "radius")

    def __init__(self, count: int) -> None:
        self.space = torch.zeros(count)  # Σ over iterations, NDC units
        self.time = torch.zeros(count)  # Σ over iterations, per duration
        self.iterations = torch.zeros(count)  # iterations in which it was seen
        self.radius = torch.zeros(count)  # pixels, largest seen
        self._space = torch.zeros(count)  # the same within the current iteration
        self._time = torch.zeros(count)
        self._views = torch.zeros(count)

    def begin(self) -> None:
        for tensor in (self._space, self._time, self._views):
            tensor.zero_()

    def add_view(
        self,
        view: ViewGradient,  # of the batch's loss
        camera: Camera,  # of that view, whose pixels the gradient is measured in
        duration: float,
        threads: int = 1,
    ) -> None:
        """Add what the backward pass of one view says."""
        view.add_to(self._space, self._time, self._views, self.radius, camera, duration, threads)

    def end(self, batch: int) -> None:
        """Fold the iteration's `batch` views into the running sums."""
        scale = self._views.clamp(min=1).reciprocal_().mul_(batch)  # where no view saw it the sums are zero
        self.space.addcmul_(self._space, scale)
        self.time.addcmul_(self._time, scale)
        self.iterations += self._views.clamp_(max=1)

    def indicators(self) -> tuple[Tensor, Tensor]:
        """Mean (space, time) indicator of each Gaussian, (N,) each; 0 where never seen."""
        seen = self.iterations.clamp(min=1)
        return self.space / seen, self.time / seen

    def state(self) -> dict[str, Tensor]:
        return {name: getattr(self, name) for name in self.FIELDS}

    @classmethod
    def restored(cls, state: dict[str, Tensor]) -> Statistics:
        statistics = cls(len(state["space"]))
        for name in cls.FIELDS:
            getattr(statistics, name).copy_(state[name])
        return statistics
