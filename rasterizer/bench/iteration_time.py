"""The time of a training iteration: rendering, loss and backward pass of each view, then Adam."""

from __future__ import annotations

from typing import Any

import torch

from rasterizer.adam import adam_step, sh_adam_step
from rasterizer.bench.frame_time import Time, clock_for
from rasterizer.bench.workloads import Workload
from rasterizer.gaussians import Gaussians
from rasterizer.gradients import Gradients
from rasterizer.loss import PhotometricLoss
from rasterizer.rasterizer import Rasterizer


def time_iteration(
    workload: Workload, threads: int, repeats: int, views: int = 4, sparse: bool = False
) -> dict[str, Time]:
    """Time by part ("rasterizer", "loss", "adam") and of the whole "iteration", over a batch of `views` views.

    sparse: Adam skips the Gaussians that no view of the batch shows.
    """
    _, clock = clock_for(threads)
    parameters = {name: p.clone() for name, p in workload.gaussians.tensors().items()}
    gaussians = Gaussians.from_tensors(parameters)
    adam = _Adam(parameters, threads)
    rasterizer, gradients, criterion = (
        Rasterizer(threads),
        Gradients.zeros_like(gaussians),
        PhotometricLoss(threads=threads),
    )
    target = torch.rand(3, workload.camera.height, workload.camera.width, generator=torch.Generator().manual_seed(1))
    spent: dict[str, list[float]] = {"rasterizer": [], "loss": [], "adam": [], "iteration": []}
    for _ in range(repeats):
        start = clock()
        gradients.zero_(threads)
        parts = dict.fromkeys(("rasterizer", "loss", "adam"), 0.0)
        visible = torch.zeros(len(gaussians), dtype=torch.uint8) if sparse else None
        for _ in range(views):
            t0 = clock()
            image = rasterizer.render(gaussians, workload.request()).color
            assert image is not None
            t1 = clock()
            d_image = criterion(image, target).d_image
            t2 = clock()
            view = rasterizer.backward(gradients, d_color=d_image)
            t3 = clock()
            if visible is not None:
                view.mark_visible(visible, threads)
            parts["rasterizer"] += t1 - t0 + t3 - t2
            parts["loss"] += t2 - t1
        t0 = clock()
        adam.step(gradients, visible)
        end = clock()
        parts["adam"] = end - t0
        for name, seconds in (parts | {"iteration": end - start}).items():
            spent[name].append(seconds)
    return {name: Time.of(seconds) for name, seconds in spent.items()}


class _Adam:
    """Adam on every parameter with learning rate 0, so that each repetition does the same work."""

    def __init__(self, parameters: dict[str, torch.Tensor], threads: int) -> None:
        self._parameters, self._threads, self._step = parameters, threads, 0
        self._m, self._v = ({name: torch.zeros_like(p) for name, p in parameters.items()} for _ in range(2))

    def step(self, gradients: Gradients, visible: torch.Tensor | None) -> None:
        self._step += 1
        options: dict[str, Any] = {"step": self._step, "sparse_rows": visible, "threads": self._threads}
        for name, p in self._parameters.items():
            m, v = self._m[name], self._v[name]
            if name == "sh":
                sh_adam_step(p, gradients, m, v, lr=[0.0] * 4, **options)
            else:
                adam_step(p, getattr(gradients, name), m, v, lr=0.0, **options)
