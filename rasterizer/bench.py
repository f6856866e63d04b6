"""How fast the kernel is: `python -m rasterizer.bench W1 [--isa v2|v3|v4] [--threads 1] [--json]`.

Three workloads, the same numbers for everybody (splitmix64, fixed seeds): W1 like a D-NeRF scene, W2 like a Plenoptic
Video scene, W2h the same at half its resolution. One thread is timed by its CPU time, minimum over repetitions,
because machines are shared; several threads by the wall clock. `--parts` shows what each part of the model and each
output costs.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch

from rasterizer import Camera, Frame, Gaussians, Gradients, Request
from rasterizer.frame import STAGES
from rasterizer.kernel import kernel

WORKLOADS = ("W1", "W2h", "W2")


class SplitMix64:
    """The generator of the workloads: draw k is a hash of seed + k · golden ratio, so rows are drawn at once."""

    def __init__(self, seed: int) -> None:
        self.state = np.uint64(seed)

    def uniform(self, rows: int, columns: int) -> np.ndarray:
        """(rows, columns) in [0, 1), 24 bits each, row by row."""
        with np.errstate(over="ignore"):
            steps = np.arange(1, rows * columns + 1, dtype=np.uint64)
            z = self.state + steps * np.uint64(0x9E3779B97F4A7C15)
            self.state = z[-1]
            z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
            z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
            z = z ^ (z >> np.uint64(31))
        return ((z >> np.uint64(40)).astype(np.float32) * np.float32(2.0**-24)).reshape(rows, columns)


class Columns:
    """Hands out a Gaussian's draws in order: a uniform takes one column of the row, a normal two (Box–Muller)."""

    def __init__(self, uniforms: np.ndarray) -> None:
        self._u, self._at = uniforms, 0

    def uniform(self) -> np.ndarray:
        self._at += 1
        return self._u[:, self._at - 1]

    def normal(self, columns: int = 1) -> np.ndarray:
        """(N, columns) standard normals."""
        pairs = self._u[:, self._at:self._at + 2 * columns]
        self._at += 2 * columns
        a, b = pairs[:, 0::2] + np.float32(1e-7), pairs[:, 1::2]
        return np.sqrt(-2 * np.log(a)) * np.cos(np.float32(2 * math.pi) * b)


@dataclass(frozen=True)
class Workload:
    gaussians: Gaussians
    camera: Camera
    time: float
    duration: float


def make_workload(name: str) -> Workload:
    """One of WORKLOADS (the distributions are in the project's performance notes)."""
    small = name == "W1"
    count = 100_000 if small else 300_000
    blocks, rng = [], SplitMix64(1234567 if small else 7654321)
    per_row = 8 * 2 + (3 + 1 + 1 + 3 + 1) * 2 + 2 + 288 if small else 8 * 2 + 4 + (1 + 3 + 1) * 2 + 1 + 288
    for start in range(0, count, 25_000):
        blocks.append(_rows(Columns(rng.uniform(min(25_000, count - start), per_row)), small))
    fields = {key: torch.from_numpy(np.concatenate([b[key] for b in blocks]).astype(np.float32)) for key in blocks[0]}
    world_to_cam = np.eye(4)
    if small:
        world_to_cam[2, 3] = 4
        camera = Camera(400, 400, 555.555, 555.555, 200, 200, world_to_cam)
    elif name == "W2h":
        camera = Camera(676, 507, 550, 550, 338, 253.5, world_to_cam)
    else:
        camera = Camera(1352, 1014, 1100, 1100, 676, 507, world_to_cam)
    return Workload(Gaussians(**fields), camera, time=0.5, duration=1.0)


def _rows(draw: Columns, small: bool) -> dict[str, np.ndarray]:
    left = draw.normal(4)
    left /= np.linalg.norm(left, axis=1, keepdims=True)
    right = left * np.array([1, 1, 1, -1], np.float32) + (0.03 if small else 0.02) * draw.normal(4)
    if small:
        direction = draw.normal(3)
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        xyz = direction * (1 - 0.12 * np.abs(draw.normal()))
        mean_t = -0.1 + 1.2 * draw.uniform()
        base, st = math.log(0.0045) + 0.5 * draw.normal(), math.log(0.15)
    else:
        z = 2 * np.exp(draw.uniform() * math.log(15))
        x = (2 * draw.uniform() - 1) * (1.05 * 1352 / 2200) * z
        y = (2 * draw.uniform() - 1) * (1.05 * 1014 / 2200) * z
        xyz = np.stack([x, y, z], axis=1)
        mean_t = -0.1 + 1.2 * draw.uniform()
        base, st = math.log(1.5) + 0.75 * draw.normal() + np.log(z / 1100)[:, None], math.log(0.14)
    scale = np.concatenate([base + 0.35 * draw.normal(3), st + 0.5 * draw.normal()], axis=1)
    opacity = 0.1 + 0.85 * draw.uniform()
    spread = np.array([1.2] + [0.15] * 15 + [0.05] * 32, np.float32)
    sh = draw.normal(144).reshape(-1, 3, 48).transpose(0, 2, 1) * spread[:, None]
    return {"mean": np.concatenate([xyz, mean_t[:, None]], axis=1), "log_scale": scale, "quat_left": left,
            "quat_right": right, "opacity_logit": np.log(opacity / (1 - opacity)), "sh": np.ascontiguousarray(sh)}


def clock_for(threads: int) -> Callable[[], float]:
    return time.process_time if threads == 1 else time.perf_counter


def measure(workload: Workload, threads: int, repeats: int, outputs: tuple[str, ...] = ("color",), **request) -> dict:
    """Minimum milliseconds of forward and backward (gradients of every parameter, SH dense), and of their stages."""
    frame, gradients, clock = Frame(threads), Gradients.zeros_like(workload.gaussians), clock_for(threads)
    camera = workload.camera
    generator = torch.Generator().manual_seed(99)
    d_color = (torch.rand(3, camera.height, camera.width, generator=generator) - 0.5) / (camera.width * camera.height)
    asked = Request(camera, workload.time, workload.duration, outputs=outputs,
                    flow_dt=0.01 if "flow" in outputs else None, **request)
    forward, backward, expand, stages = [], [], [], []
    d_sh = torch.zeros_like(workload.gaussians.sh)
    for _ in range(repeats):
        gradients.zero_()
        t0 = clock()
        frame.render(workload.gaussians, asked)
        t1 = clock()
        frame.backward(gradients, d_color=d_color)
        t2 = clock()
        gradients.sh(threads, out=d_sh)
        t3 = clock()
        forward.append(t1 - t0), backward.append(t3 - t1), expand.append(t3 - t2)
        stages.append(list(frame.stage_ms.values()))
    best = dict(zip(STAGES, np.min(stages, axis=0).round(3).tolist(), strict=True))
    best["expand_sh"] = round(1e3 * min(expand), 3)
    totals = [f + b for f, b in zip(forward, backward, strict=True)]
    return {"forward_ms": round(1e3 * min(forward), 3), "backward_ms": round(1e3 * min(backward), 3),
            "total_ms": round(1e3 * min(totals), 3), "stages": best, "visible": frame.visible,
            "alive": frame.alive}


def measure_parts(workload: Workload, threads: int, repeats: int) -> list[tuple[str, dict]]:
    """The same workload with parts of the model left out, and with outputs asked for."""
    g = workload.gaussians
    orders = {n: g.sh[:, :16 * (n + 1)].contiguous() for n in range(3)}
    xyz, scale = g.mean[:, :3].contiguous(), g.log_scale[:, :3].contiguous()
    without = [
        ("full model, colour only", g),
        ("without Fourier order 2", replace(g, sh=orders[1])),
        ("without 4DSH", replace(g, sh=orders[0])),
        ("without 4D rotation", replace(g, quat_right=None)),
        ("without 4D rotation and 4DSH", replace(g, quat_right=None, sh=orders[0])),
        ("static: no time at all (all Gaussians alive)",
         Gaussians(xyz, scale, g.quat_left, None, g.opacity_logit, orders[0])),
    ]
    rows = [(label, measure(Workload(model, workload.camera, workload.time, workload.duration), threads, repeats))
            for label, model in without]
    for extra in (("alpha",), ("depth",), ("flow",), ("stats",), ("alpha", "depth", "flow", "stats")):
        rows.append((f"full model + {', '.join(extra)}", measure(workload, threads, repeats, outputs=("color", *extra))))
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m rasterizer.bench", description=__doc__.splitlines()[0])
    parser.add_argument("workload", choices=WORKLOADS)
    parser.add_argument("--isa", choices=("v2", "v3", "v4", "plain"), help="instruction set (default: the best there is)")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--parts", action="store_true", help="what each part costs when on")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    options = parser.parse_args()
    if options.isa and os.environ.get("RASTERIZER_ISA") != options.isa:
        # The kernel is chosen when the package is imported, which has happened by now: start again.
        environment = os.environ | {"RASTERIZER_ISA": options.isa}
        os.execve(sys.executable, [sys.executable, "-m", "rasterizer.bench", *sys.argv[1:]], environment)
    torch.set_num_threads(1)
    workload, isa = make_workload(options.workload), kernel.__name__.rsplit("_", 1)[1]
    head = {"workload": options.workload, "isa": isa, "threads": options.threads}
    if options.parts:
        rows = measure_parts(workload, options.threads, options.repeats)
        if options.json:
            print(json.dumps(head | {"parts": {label: row for label, row in rows}}))
            return
        print(f"{options.workload}, {isa}, {options.threads} thread(s), minimum of {options.repeats}, ms")
        for label, row in rows:
            print(f"  {label:<46} {row['visible']:6} visible  forward {row['forward_ms']:7.2f}  "
                  f"backward {row['backward_ms']:7.2f}  total {row['total_ms']:7.2f}")
        return
    result = head | measure(workload, options.threads, options.repeats)
    if options.json:
        print(json.dumps(result))
        return
    print(f"{options.workload}, {isa}, {options.threads} thread(s), minimum of {options.repeats}: "
          f"{result['visible']} of {len(workload.gaussians)} Gaussians visible")
    for stage, ms in result["stages"].items():
        print(f"  {stage:<18} {ms:8.2f} ms")
    print(f"  forward {result['forward_ms']:.2f} ms, backward {result['backward_ms']:.2f} ms, "
          f"total {result['total_ms']:.2f} ms")


if __name__ == "__main__":
    main()
