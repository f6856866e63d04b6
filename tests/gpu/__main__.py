"""Checks and times the rasterizer on a GPU, in at most six minutes (make gpu-test).

gsplat is compiled and gives one gradient; then images, gradients and statistics of all scenes of the tests, against
float64 and the kernel; a short training; and frames of 300,000 Gaussians. Exit status 1 where a check fails, and where
there is no GPU. --twins: the table of the scenes alone, on the CPU by gsplat's PyTorch twins.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from contextlib import nullcontext
from pathlib import Path

import torch
from builders import camera_looking_at, generator, random_gaussians
from gsplat_parity import (
    DIFFERENT,
    SAME,
    by_engine,
    by_reference,
    gradient_error,
    image_error,
    seen_by_one,
    single,
    statistics_error,
)
from gsplat_twins import gsplat_on_the_cpu

from pipeline.runs.provenance import engine_record
from rasterizer import Gaussians, Gradients, Rasterizer, Request
from rasterizer.gsplat_rasterizer import GsplatRasterizer, NoGpu, gpu

# Of the largest value. The kernel's tests have 3e-5 and 1e-4; gsplat is compiled with approximate exponentials.
IMAGE_TOLERANCE, GRADIENT_TOLERANCE = 2e-4, 2e-3
TRAIN_SECONDS = 60  # budget of the training
COUNT, SIZE, REPEATS = 300_000, (1352, 1014), 50


def main() -> int:
    parser = argparse.ArgumentParser(prog="gpu", description=__doc__)
    parser.add_argument("--twins", action="store_true")
    if parser.parse_args().twins:
        parity(torch.device("cpu"))
        return 0
    started = time.perf_counter()
    try:
        device = gpu()
    except NoGpu as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    print(json.dumps(engine_record("gsplat")))
    scene = single()
    truth, weights = by_reference(scene)
    error = gradient_error(by_engine(GsplatRasterizer(device), scene, weights, torch.float32), truth)
    print(f"compiled, one gradient: off by {error:.1e}, after {time.perf_counter() - started:.0f} s", flush=True)
    checks = [error < GRADIENT_TOLERANCE, parity(device), train(), *speed(device)]
    print(f"{checks.count(False)} of {len(checks)} checks failed, {time.perf_counter() - started:.0f} s")
    return 0 if all(checks) else 1


def parity(device: torch.device) -> bool:
    """The table of docs/gpu.md; False where scenes that should be the same differ."""
    on_cpu = device.type == "cpu"
    types = (torch.float64, torch.float32) if on_cpu else (torch.float32,)
    heads = [f"{what}, {str(dtype)[6:]}" for what in ("images", "gradients") for dtype in types]
    print("| case |", " | ".join([*heads, "statistics", "the kernel's images", "gradients", "seen by one alone"]), "|")
    print("| -- |" + " -: |" * (len(heads) + 4))
    same = True
    for name, make in (SAME | DIFFERENT).items():
        scene = make()
        truth, weights = by_reference(scene)
        with gsplat_on_the_cpu() if on_cpu else nullcontext():
            found = [by_engine(GsplatRasterizer(device), scene, weights, dtype) for dtype in types]
        kernel = by_engine(Rasterizer(1), scene, weights, torch.float32)
        images, gradients = (
            [image_error(one, truth, scene) for one in found],
            [gradient_error(one, truth) for one in found],
        )
        statistics = statistics_error(found[-1], kernel)
        own = [image_error(kernel, truth, scene), gradient_error(kernel, truth)]
        seen = "/".join(str(len(rows)) for rows in seen_by_one(found[-1], kernel))
        print(f"| {name} |", " | ".join([*(f"{x:.1e}" for x in (*images, *gradients, statistics, *own)), seen]), "|")
        if name in SAME:
            same &= images[-1] < IMAGE_TOLERANCE and max(gradients[-1], statistics) < GRADIENT_TOLERANCE
    sys.stdout.flush()
    return same


def train() -> bool:
    """A run of the program on synthetic/wheel for TRAIN_SECONDS; False where it fails."""
    with tempfile.TemporaryDirectory() as folder:
        keys = ["backend=gsplat", f"train.time_budget_s={TRAIN_SECONDS}", f"out={folder}/run", "evaluate.lpips=false"]
        done = subprocess.run([sys.executable, "-m", "pipeline", "scene=synthetic/wheel", "train=short", *keys])
        if done.returncode != 0:
            return False
        metrics = json.loads((Path(folder) / "run" / "metrics.json").read_text())
    final = metrics["final"]
    print(
        f"trained: {metrics['iterations']} iterations in {metrics['train_seconds']:.0f} s, PSNR {final['psnr']:.2f}, "
        f"{metrics['n_gaussians']} Gaussians, {final['fps_render']:.0f} frames a second",
        flush=True,
    )
    return True


def speed(device: torch.device) -> list[bool]:
    """Milliseconds of COUNT random Gaussians, memory, and whether two backward passes agree to the bit."""
    gaussians = random_gaussians(COUNT, "velocity", generator(0), log_scale=(-6.0, -4.0)).to(torch.float32)
    tensors = {name: tensor.to(device) for name, tensor in gaussians.tensors().items()}
    gaussians = Gaussians.from_tensors(tensors)
    camera = camera_looking_at((0.0, 0.0, -3.0), *SIZE, focal=1200.0)
    engine, request, gradients = GsplatRasterizer(device), Request(camera, time=0.5), Gradients.zeros_like(gaussians)
    d_color = torch.ones(3, camera.height, camera.width, device=device)

    def frame(backward: bool) -> None:
        engine.render(gaussians, request, differentiable=backward)
        if backward:
            gradients.zero_()
            engine.backward(gradients, d_color=d_color)

    torch.cuda.reset_peak_memory_stats()
    for backward in (False, True):
        frame(backward)
        torch.cuda.synchronize()
        began = time.perf_counter()
        for _ in range(REPEATS):
            frame(backward)
        torch.cuda.synchronize()
        took = 1000 * (time.perf_counter() - began) / REPEATS
        what = "forward and backward" if backward else "forward"
        print(f"{what}: {took:.2f} ms, {COUNT} Gaussians, {engine.alive} alive, {SIZE[0]} × {SIZE[1]}")
    first = gradients.mean.clone()
    frame(True)
    print(f"two backward passes are {'the same' if torch.equal(first, gradients.mean) else 'not the same'} bits")
    print(f"peak memory of the device: {torch.cuda.max_memory_allocated() / 1e6:.0f} MB")
    return [gradients.all_finite()]


if __name__ == "__main__":
    sys.exit(main())
