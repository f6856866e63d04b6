"""The time of one rendered frame, forward and backward, by stage, the work in it, and the time of a training iteration.

One thread is timed by its CPU time, since machines are shared; several threads by the wall clock.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import torch

from rasterizer.adam import adam_step, sh_adam_step
from rasterizer.bench.workloads import Workload
from rasterizer.gaussians import Gaussians
from rasterizer.gradients import Gradients
from rasterizer.loss import PhotometricLoss
from rasterizer.rasterizer import STAGES, Rasterizer
from rasterizer.request import Request


@dataclass(frozen=True)
class Time:
    """Milliseconds over the repetitions."""

    minimum: float
    median: float

    @classmethod
    def of(cls, seconds: list[float]) -> Time:
        return cls(round(1e3 * min(seconds), 3), round(1e3 * statistics.median(seconds), 3))


@dataclass(frozen=True)
class FrameTime:
    """One view, forward and backward, with gradients of every parameter."""

    threads: int
    clock: str  # cpu or wall
    stages: dict[str, Time]  # wall clock, by stage of the kernel
    forward: Time
    backward: Time  # SH gradients compact, as in training
    total: Time
    expand_sh: Time  # expanding them to (N, K, 3), which training never does


@dataclass(frozen=True)
class WorkCounts:
    gaussians: int
    alive: int  # p(t) >= 0.05
    visible: int
    intersections: int  # (tile, Gaussian)
    pairs: int  # (pixel, Gaussian) evaluated
    contributing: int  # of these pairs
    pixels: int


def clock_for(threads: int) -> tuple[str, Callable[[], float]]:
    """("cpu" or "wall", a clock in seconds) for this number of threads."""
    return ("cpu", time.process_time) if threads == 1 else ("wall", time.perf_counter)


def time_frame(workload: Workload, threads: int, repeats: int, **options) -> FrameTime:
    """Render the workload's view `repeats` times; options as Request's (outputs, flow_dt)."""
    clock_name, clock = clock_for(threads)
    rasterizer, gradients = Rasterizer(threads), Gradients.zeros_like(workload.gaussians)
    request, d_color = workload.request(**options), workload.image_gradient()
    d_sh = torch.zeros_like(workload.gaussians.sh)
    timestamps: list[list[float]] = []
    stages: dict[str, list[float]] = {stage: [] for stage in STAGES}
    for _ in range(repeats):
        gradients.zero_(threads)
        at = [clock()]
        rasterizer.render(workload.gaussians, request)
        at.append(clock())
        rasterizer.backward(gradients, d_color=d_color)
        at.append(clock())
        gradients.sh(threads, out=d_sh)
        at.append(clock())
        timestamps.append(at)
        for stage, ms in rasterizer.stage_ms.items():
            stages[stage].append(ms / 1e3)

    def span(first: int, last: int) -> Time:
        return Time.of([at[last] - at[first] for at in timestamps])

    return FrameTime(
        threads,
        clock_name,
        {stage: Time.of(seconds) for stage, seconds in stages.items()},
        forward=span(0, 1),
        backward=span(1, 2),
        total=span(0, 2),
        expand_sh=span(2, 3),
    )


def count_work(workload: Workload) -> WorkCounts:
    rasterizer = Rasterizer(1)
    rasterizer.render(workload.gaussians, workload.request())
    pairs, contributing = rasterizer.count_pairs()
    return WorkCounts(
        gaussians=len(workload.gaussians),
        alive=rasterizer.alive,
        visible=rasterizer.visible,
        intersections=rasterizer.intersections,
        pairs=pairs,
        contributing=contributing,
        pixels=workload.camera.width * workload.camera.height,
    )


def time_iteration(
    workload: Workload, threads: int, repeats: int, views: int = 4, sparse: bool = False, **options
) -> dict[str, Time]:
    """Time by part ("rasterizer", "loss", "adam") and of the whole "iteration": rendering, loss and backward pass of
    `views` views, evenly spread in time, then Adam. Every output that is rendered has a gradient.

    sparse: Adam skips the Gaussians that no view of the batch shows. options: as Request's (outputs, flow_dt).
    """
    _, clock = clock_for(threads)
    parameters = {name: p.clone() for name, p in workload.gaussians.tensors().items()}
    gaussians = Gaussians.from_tensors(parameters)
    adam = _Adam(parameters, threads)
    rasterizers, gradients = [Rasterizer(threads) for _ in range(views)], Gradients.zeros_like(gaussians)
    requests = batch_of(workload, views, **options)
    criterion = PhotometricLoss(threads=threads)
    target = torch.rand(3, workload.camera.height, workload.camera.width, generator=torch.Generator().manual_seed(1))
    channels = {"alpha": 1, "depth": 1, "flow": 2, "stats": 2}
    others: dict[str, Any] = {
        f"d_{name}": target[:count] - 0.5 for name, count in channels.items() if name in requests[0].outputs
    }
    spent: dict[str, list[float]] = {"rasterizer": [], "loss": [], "adam": [], "iteration": []}
    for _ in range(repeats):
        start = clock()
        gradients.zero_(threads)
        parts = dict.fromkeys(("rasterizer", "loss", "adam"), 0.0)
        visible = torch.zeros(len(gaussians), dtype=torch.uint8) if sparse else None
        t0 = clock()
        rendered = Rasterizer.render_batch(rasterizers, gaussians, requests)
        parts["rasterizer"] += clock() - t0
        for rasterizer, out in zip(rasterizers, rendered, strict=True):
            assert out.color is not None
            t0 = clock()
            d_color = criterion(out.color, target).d_image
            t1 = clock()
            view = rasterizer.backward(gradients, d_color=d_color, **others)
            t2 = clock()
            if visible is not None:
                view.mark_visible(visible, threads)
            parts["rasterizer"] += t2 - t1
            parts["loss"] += t1 - t0
        t0 = clock()
        adam.step(gradients, visible)
        end = clock()
        parts["adam"] = end - t0
        for name, seconds in (parts | {"iteration": end - start}).items():
            spent[name].append(seconds)
    return {name: Time.of(seconds) for name, seconds in spent.items()}


def time_batch(workload: Workload, threads: int, repeats: int, views: int = 4) -> tuple[Time, Time]:
    """The forward passes of the iteration's views: in one call, and in turn with it each on its own."""
    _, clock = clock_for(threads)
    requests, rasterizers = batch_of(workload, views), [Rasterizer(threads) for _ in range(views)]
    together, alone = [], []
    for _ in range(repeats):
        t0 = clock()
        Rasterizer.render_batch(rasterizers, workload.gaussians, requests)
        t1 = clock()
        for request in requests:
            rasterizers[0].render(workload.gaussians, request)
        together.append(t1 - t0)
        alone.append(clock() - t1)
    return Time.of(together), Time.of(alone)


def batch_of(workload: Workload, views: int, **options) -> list[Request]:
    """Views evenly spread in time."""
    return [replace(workload, time=(view + 0.5) / views).request(**options) for view in range(views)]


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
