"""The time of one rendered frame, forward and backward, by stage, and the amount of work in it.

One thread is timed by its CPU time, since machines are shared; several threads by the wall clock.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass

import torch

from rasterizer.bench.workloads import Workload
from rasterizer.gradients import Gradients
from rasterizer.rasterizer import STAGES, Rasterizer


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
