"""What the kernel's times are compared with: plain PyTorch, and the model with parts left out or outputs added."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import torch
import torch.nn.functional as F
from torch import Tensor

from rasterizer import Gaussians
from rasterizer.bench.frame_time import FrameTime, Time, count_work, time_frame
from rasterizer.bench.workloads import Workload
from rasterizer.loss import PhotometricLoss
from rasterizer.reference import rasterize as reference_rasterize

EXTRA_OUTPUTS = (("alpha",), ("depth",), ("flow",), ("stats",), ("alpha", "depth", "flow", "stats"))


def time_loss(pixels: int, repeats: int) -> tuple[Time, Time]:
    """(kernel, torch): loss and gradient of an image of `pixels` × `pixels` on one thread, CPU time."""
    generator = torch.Generator().manual_seed(2)
    image, target = (torch.rand(3, pixels, pixels, generator=generator) for _ in range(2))
    criterion = PhotometricLoss(threads=1)
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


def torch_loss(image: Tensor, target: Tensor, ssim_weight: float = 0.2) -> Tensor:
    """(1-λ) L1 + λ (1-SSIM) as in 3DGS: an 11×11 window (σ = 1.5) by grouped conv2d. (3, H, W) each."""
    line = torch.exp(-(torch.arange(-5, 6) ** 2) / 4.5)
    line = line / line.sum()
    window = (line[:, None] * line[None]).expand(3, 1, 11, 11).contiguous()

    def mean(x: Tensor) -> Tensor:
        return F.conv2d(x[None], window, padding=5, groups=3)[0]

    m, n = mean(image), mean(target)
    variance_x, variance_y = mean(image * image) - m * m, mean(target * target) - n * n
    covariance = mean(image * target) - m * n
    ssim = ((2 * m * n + 1e-4) * (2 * covariance + 9e-4)) / ((m * m + n * n + 1e-4) * (variance_x + variance_y + 9e-4))
    return (1 - ssim_weight) * (image - target).abs().mean() + ssim_weight * (1 - ssim.mean())


def time_reference(workload: Workload, pixels: int) -> tuple[Time, Time]:
    """(kernel, reference): forward and backward of the middle `pixels` × `pixels` of a workload on one thread.

    A crop, since the reference implementation keeps every (pixel, Gaussian) pair for autograd.
    """
    crop = workload.cropped(pixels)
    d_color = crop.image_gradient()
    leaves = Gaussians.from_tensors({name: p.clone().requires_grad_() for name, p in crop.gaussians.tensors().items()})
    start = time.process_time()
    image = reference_rasterize(leaves, crop.camera, crop.time, duration=crop.duration).color
    assert image is not None
    image.backward(d_color)
    reference = time.process_time() - start
    kernel = time_frame(crop, 1, 5)
    return kernel.total, Time.of([reference])


def time_parts(workload: Workload, threads: int, repeats: int) -> dict[str, tuple[int, FrameTime]]:
    """(number of visible Gaussians, time) by label."""
    rows = {}
    for label, model in reduced_models(workload.gaussians).items():
        reduced = replace(workload, gaussians=model)
        rows[label] = count_work(reduced).visible, time_frame(reduced, threads, repeats)
    visible = count_work(workload).visible
    for extra in EXTRA_OUTPUTS:
        flow_dt = 0.01 if "flow" in extra else None
        time = time_frame(workload, threads, repeats, outputs=("color", *extra), flow_dt=flow_dt)
        rows[f"full model + {', '.join(extra)}"] = visible, time
    return rows


def reduced_models(g: Gaussians) -> dict[str, Gaussians]:
    """The full model `g` (16 spherical harmonics, Fourier order 2) and the same Gaussians without some parts."""
    orders = {n: g.sh[:, : 16 * (n + 1)].contiguous() for n in range(3)}
    xyz, scale = g.mean[:, :3].contiguous(), g.log_scale[:, :3].contiguous()
    return {
        "full model, colour only": g,
        "without Fourier order 2": replace(g, sh=orders[1]),
        "without 4DSH": replace(g, sh=orders[0]),
        "without 4D rotation": replace(g, quat_right=None),
        "without 4D rotation and 4DSH": replace(g, quat_right=None, sh=orders[0]),
        "static: no time at all (all Gaussians alive)": Gaussians(
            xyz, scale, g.quat_left, None, g.opacity_logit, orders[0]
        ),
    }
