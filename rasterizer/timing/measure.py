"""Timing: the stages of a frame, a training iteration, the loss, and the readable twin.

One thread is timed by its CPU time, because machines are shared; several by the wall clock.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
import torch.nn.functional as F

from rasterizer import Gaussians, Gradients, Rasterizer
from rasterizer.adam import adam_step, sh_adam_step
from rasterizer.forward_backward import STAGES
from rasterizer.loss import L1Ssim
from rasterizer.reference import render as reference
from rasterizer.timing.workloads import Workload

FORWARD = STAGES[:4]  # blend's image included


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
    stages: dict[str, Time]  # wall clock, of the kernel's stages
    forward: Time  # image included
    backward: Time  # the SH gradient as the compact colour gradients that training takes
    total: Time
    expand_sh: Time  # the SH gradient written out, (N, K, 3); training never does


def clock_for(threads: int) -> tuple[str, Callable[[], float]]:
    return ("cpu", time.process_time) if threads == 1 else ("wall", time.perf_counter)


def time_frame(workload: Workload, threads: int, repeats: int, **options) -> FrameTime:
    """Repeat a view; options as Request's (outputs, flow_dt)."""
    name, clock = clock_for(threads)
    frame, gradients, d_color = Rasterizer(threads), Gradients.zeros_like(workload.gaussians), workload.image_gradient()
    request, d_sh = workload.request(**options), torch.zeros_like(workload.gaussians.sh)
    marks, stages = [], {stage: [] for stage in STAGES}
    for _ in range(repeats):
        gradients.zero_(threads)
        at = [clock()]
        frame.render(workload.gaussians, request)
        at.append(clock())
        frame.backward(gradients, d_color=d_color)
        at.append(clock())
        gradients.sh(threads, out=d_sh)
        at.append(clock())
        marks.append(at)
        for stage, ms in frame.stage_ms.items():
            stages[stage].append(ms / 1e3)

    def span(first: int, last: int) -> Time:
        return Time.of([at[last] - at[first] for at in marks])

    return FrameTime(
        threads,
        name,
        {stage: Time.of(seconds) for stage, seconds in stages.items()},
        span(0, 1),
        span(1, 2),
        span(0, 2),
        span(2, 3),
    )


@dataclass(frozen=True)
class Counts:
    """How much there is to do in a frame."""

    gaussians: int
    alive: int  # p(t) >= 0.05
    visible: int
    entries: int  # (tile, Gaussian)
    pairs: int  # (pixel, Gaussian) evaluated
    contributing: int
    pixels: int


def count(workload: Workload) -> Counts:
    frame = Rasterizer(1)
    frame.render(workload.gaussians, workload.request())
    pairs, contributing = frame.count_pairs()
    return Counts(
        len(workload.gaussians),
        frame.alive,
        frame.visible,
        frame.entries,
        pairs,
        contributing,
        workload.camera.width * workload.camera.height,
    )


def time_parts(workload: Workload, threads: int, repeats: int) -> dict[str, tuple[int, FrameTime]]:
    """The same workload with parts of the model left out and with outputs asked for: (visible, time) by label."""
    g = workload.gaussians
    orders = {n: g.sh[:, : 16 * (n + 1)].contiguous() for n in range(3)}
    xyz, scale = g.mean[:, :3].contiguous(), g.log_scale[:, :3].contiguous()
    models = {
        "full model, colour only": g,
        "without Fourier order 2": replace(g, sh=orders[1]),
        "without 4DSH": replace(g, sh=orders[0]),
        "without 4D rotation": replace(g, quat_right=None),
        "without 4D rotation and 4DSH": replace(g, quat_right=None, sh=orders[0]),
        "static: no time at all (all Gaussians alive)": Gaussians(
            xyz, scale, g.quat_left, None, g.opacity_logit, orders[0]
        ),
    }
    rows = {}
    for label, model in models.items():
        other = replace(workload, gaussians=model)
        rows[label] = count(other).visible, time_frame(other, threads, repeats)
    visible = count(workload).visible
    for extra in (("alpha",), ("depth",), ("flow",), ("stats",), ("alpha", "depth", "flow", "stats")):
        flow_dt = 0.01 if "flow" in extra else None
        rows[f"full model + {', '.join(extra)}"] = (
            visible,
            time_frame(workload, threads, repeats, outputs=("color", *extra), flow_dt=flow_dt),
        )
    return rows


def time_iteration(
    workload: Workload, threads: int, repeats: int, views: int = 4, sparse: bool = False
) -> dict[str, Time]:
    """A training iteration's parts: `views` times render, loss and backward, then Adam on every parameter."""
    _, clock = clock_for(threads)
    parameters = {name: p.clone() for name, p in workload.gaussians.tensors().items()}
    gaussians = Gaussians(**{"quat_right": None, **parameters})
    first, second = ({name: torch.zeros_like(p) for name, p in parameters.items()} for _ in range(2))
    frame, gradients, criterion = Rasterizer(threads), Gradients.zeros_like(gaussians), L1Ssim(threads=threads)
    target = torch.rand(3, workload.camera.height, workload.camera.width, generator=torch.Generator().manual_seed(1))
    spent: dict[str, list[float]] = {"rasterizer": [], "loss": [], "adam": [], "iteration": []}
    for step in range(1, repeats + 1):
        start = clock()
        gradients.zero_(threads)
        parts = dict.fromkeys(("rasterizer", "loss", "adam"), 0.0)
        touched = torch.zeros(len(gaussians), dtype=torch.uint8) if sparse else None
        for _ in range(views):
            t0 = clock()
            image = frame.render(gaussians, workload.request()).color
            t1 = clock()
            d_image = criterion(image, target).d_image
            t2 = clock()
            seen = frame.backward(gradients, d_color=d_image)
            t3 = clock()
            if sparse:
                seen.mark(touched, threads)
            parts["rasterizer"] += t1 - t0 + t3 - t2
            parts["loss"] += t2 - t1
        t0 = clock()
        for name, p in parameters.items():  # with rate 0: the same work each time
            if name == "sh":
                sh_adam_step(
                    p, gradients, first[name], second[name], [0.0] * 4, step, sparse_rows=touched, threads=threads
                )
            else:
                adam_step(
                    p,
                    getattr(gradients, name),
                    first[name],
                    second[name],
                    0.0,
                    step,
                    sparse_rows=touched,
                    threads=threads,
                )
        end = clock()
        parts["adam"] = end - t0
        for name, seconds in (parts | {"iteration": end - start}).items():
            spent[name].append(seconds)
    return {name: Time.of(seconds) for name, seconds in spent.items()}


def time_loss(pixels: int, repeats: int) -> tuple[Time, Time]:
    """L1 + SSIM forward and backward on one thread: ours, and the same in torch with conv2d and autograd."""
    generator = torch.Generator().manual_seed(2)
    image, target = (torch.rand(3, pixels, pixels, generator=generator) for _ in range(2))
    criterion = L1Ssim(threads=1)
    leaf = image.clone().requires_grad_()

    def repeat(run: Callable[[], object], times: int) -> Time:
        seconds = []
        for _ in range(times):
            start = time.process_time()
            run()
            seconds.append(time.process_time() - start)
        return Time.of(seconds)

    return repeat(lambda: criterion(image, target), 10 * repeats), repeat(
        lambda: torch.autograd.grad(torch_loss(leaf, target), leaf), repeats
    )


def torch_loss(image: torch.Tensor, target: torch.Tensor, ssim_weight: float = 0.2) -> torch.Tensor:
    """(1-λ) L1 + λ (1-SSIM) as 3D Gaussian Splatting writes it: an 11×11 window by grouped conv2d. (3, H, W) each."""
    line = torch.exp(-(torch.arange(-5, 6) ** 2) / 4.5)
    line = line / line.sum()
    window = (line[:, None] * line[None]).expand(3, 1, 11, 11).contiguous()

    def mean(x: torch.Tensor) -> torch.Tensor:
        return F.conv2d(x[None], window, padding=5, groups=3)[0]

    m, n = mean(image), mean(target)
    variance_x, variance_y = mean(image * image) - m * m, mean(target * target) - n * n
    covariance = mean(image * target) - m * n
    ssim = ((2 * m * n + 1e-4) * (2 * covariance + 9e-4)) / ((m * m + n * n + 1e-4) * (variance_x + variance_y + 9e-4))
    return (1 - ssim_weight) * (image - target).abs().mean() + ssim_weight * (1 - ssim.mean())


def time_reference(workload: Workload, pixels: int) -> tuple[Time, Time]:
    """Forward and backward of the middle `pixels`² of a workload on one thread: the kernel, and the readable twin.

    A crop, because the twin keeps every (pixel, Gaussian) pair for autograd.
    """
    crop = workload.cropped(pixels)
    d_color = crop.image_gradient()
    leaves = Gaussians(**{name: p.clone().requires_grad_() for name, p in crop.gaussians.tensors().items()})
    start = time.process_time()
    image = reference.rasterize(leaves, crop.camera, crop.time, duration=crop.duration).color
    image.backward(d_color)
    twin = time.process_time() - start
    ours = time_frame(crop, 1, 5)
    return ours.total, Time.of([twin])
