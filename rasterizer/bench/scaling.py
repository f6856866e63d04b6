"""How the CPU time of a training iteration grows with Gaussians, pixels and views, and that of a view with threads."""

from __future__ import annotations

import heapq
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from rasterizer.bench.frame_time import Time, time_iteration
from rasterizer.bench.workloads import Workload
from rasterizer.gradients import Gradients
from rasterizer.rasterizer import Rasterizer

SHARES = (0.125, 0.25, 0.5, 1.0)  # of the workload's Gaussians, and of its pixels
VIEWS = (1, 2, 4, 8)
THREADS = (1, 2, 4, 8, 16, 64)
TILE = 16  # pixels


@dataclass(frozen=True)
class Growth:
    """CPU milliseconds of an iteration by size."""

    what: str
    sizes: tuple[int, ...]
    ms: tuple[float, ...]

    @property
    def exponents(self) -> tuple[float, ...]:
        """Of size in the time, from one size to the next: 0 for a constant cost, 1 for a proportional one."""
        return tuple(np.diff(np.log(self.ms)) / np.diff(np.log(self.sizes)))


def measure_growth(workload: Workload, repeats: int) -> list[Growth]:
    """On one thread, the fastest of `repeats`. Fewer Gaussians are a part of the workload's, fewer pixels the same view
    in a smaller image."""
    gaussians, camera = workload.gaussians, workload.camera
    fewer = [
        replace(workload, gaussians=gaussians.rows(torch.arange(round(share * len(gaussians))))) for share in SHARES
    ]
    smaller = [
        replace(workload, camera=camera.resized(round(share**0.5 * camera.width), round(share**0.5 * camera.height)))
        for share in SHARES
    ]
    pixels = [one.camera.width * one.camera.height for one in smaller]
    return [
        _growth("Gaussians", [len(one.gaussians) for one in fewer], [_iteration(one, repeats) for one in fewer]),
        _growth("pixels", pixels, [_iteration(one, repeats) for one in smaller]),
        _growth("views", VIEWS, [_iteration(workload, repeats, views) for views in VIEWS]),
    ]


def measure_threads(workload: Workload, repeats: int) -> list[tuple[int, Time]]:
    """CPU time of all threads together, forward and backward. What it grows by is at most what sharing the work costs:
    more threads than cores also disturb each other."""
    d_color, found = workload.image_gradient(), []
    for threads in THREADS:
        rasterizer, gradients = Rasterizer(threads), Gradients.zeros_like(workload.gaussians)
        seconds = []
        for _ in range(repeats):
            started = time.process_time()
            rasterizer.render(workload.gaussians, workload.request())
            rasterizer.backward(gradients, d_color=d_color)
            seconds.append(time.process_time() - started)
        found.append((threads, Time.of(seconds)))
    return found


def simulated_waiting(workload: Workload, repeats: int) -> list[tuple[int, float]]:
    """Share of the threads' time that they wait for the last in the two passes of blending, by number of threads.

    The thread that is free first takes the next tiles, a number of them in sequence (tiles_together in blend.hpp). How
    long they take is measured on one thread, by rendering the strips of the image that they are; the schedule is
    simulated.
    """
    camera = workload.camera
    tiles = math.ceil(camera.width / TILE) * math.ceil(camera.height / TILE)
    together = {threads: min(max(tiles // (32 * threads), 1), 8) for threads in THREADS[1:]}
    seconds = {number: strip_seconds(workload, number, repeats) for number in set(together.values())}
    return [(threads, waiting_share(seconds[number], threads)) for threads, number in together.items()]


def strip_seconds(workload: Workload, tiles: int, repeats: int) -> list[float]:
    """Of blending in each strip of as many tiles, in order; the fastest of `repeats`."""
    c, width = workload.camera, tiles * TILE
    rasterizer, gradients = Rasterizer(1), Gradients.zeros_like(workload.gaussians)
    found = []
    for top in range(0, c.height, TILE):
        for left in range(0, c.width, width):
            here = replace(c, width=min(width, c.width - left), height=min(TILE, c.height - top))
            strip = replace(workload, camera=replace(here, cx=c.cx - left, cy=c.cy - top))
            d_color, spent = strip.image_gradient(), []
            for _ in range(repeats):
                rasterizer.render(strip.gaussians, strip.request())
                rasterizer.backward(gradients, d_color=d_color)
                spent.append(rasterizer.stage_ms["blend"] + rasterizer.stage_ms["blend_backward"])
            found.append(min(spent) / 1e3)
    return found


def waiting_share(seconds: Sequence[float], threads: int) -> float:
    """Share of the threads' time without work, where each takes the next item as soon as it is free."""
    free = [0.0] * threads
    for spent in seconds:
        heapq.heapreplace(free, free[0] + spent)
    return 1 - sum(seconds) / (threads * max(free))


def _growth(what: str, sizes: Sequence[int], ms: Sequence[float]) -> Growth:
    return Growth(what, tuple(sizes), tuple(ms))


def _iteration(workload: Workload, repeats: int, views: int = 4) -> float:
    return time_iteration(workload, 1, repeats, views)["iteration"].minimum
