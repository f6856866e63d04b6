"""Synthetic benchmark scenes, identical on every machine: drawn from splitmix64 with fixed seeds.

W1 resembles a D-NeRF scene, W2 a Plenoptic Video scene; W2h is W2 at half its resolution.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import torch

from rasterizer.camera import Camera
from rasterizer.gaussians import Gaussians
from rasterizer.request import Request

WORKLOADS = ("W1", "W2h", "W2")


class SplitMix64:
    """The splitmix64 generator: draw k hashes seed + k · golden ratio, so that draws are vectorized."""

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
    """Random variables from columns of uniform draws, in order: one column per uniform, two per normal (Box-Muller)."""

    def __init__(self, uniforms: np.ndarray) -> None:
        self._u, self._at = uniforms, 0

    def uniform(self) -> np.ndarray:
        self._at += 1
        return self._u[:, self._at - 1]

    def normal(self, columns: int = 1) -> np.ndarray:
        """(N, columns) standard normals."""
        pairs = self._u[:, self._at : self._at + 2 * columns]
        self._at += 2 * columns
        a, b = pairs[:, 0::2] + np.float32(1e-7), pairs[:, 1::2]
        return np.sqrt(-2 * np.log(a)) * np.cos(np.float32(2 * math.pi) * b)


@dataclass(frozen=True)
class Workload:
    gaussians: Gaussians
    camera: Camera
    time: float  # in the unit of duration
    duration: float

    def request(self, **options) -> Request:
        """The view to render; options as Request's."""
        return Request(self.camera, self.time, self.duration, **options)

    def image_gradient(self) -> torch.Tensor:
        """A random ∂L/∂image (3, H, W), scaled as that of a mean over pixels."""
        size = self.camera.height, self.camera.width
        return (torch.rand(3, *size, generator=torch.Generator().manual_seed(99)) - 0.5) / (size[0] * size[1])

    def cropped(self, pixels: int) -> Workload:
        c = self.camera
        left, top = (c.width - pixels) // 2, (c.height - pixels) // 2
        return replace(self, camera=replace(c, width=pixels, height=pixels, cx=c.cx - left, cy=c.cy - top))


def make_workload(name: str) -> Workload:
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
    return Workload(Gaussians.from_tensors(fields), camera, time=0.5, duration=1.0)


def _rows(draw: Columns, small: bool) -> dict[str, np.ndarray]:
    """Parameters of as many Gaussians as `draw` has rows. small: W1, a shell about the origin; else a frustum."""
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
    return {
        "mean": np.concatenate([xyz, mean_t[:, None]], axis=1),
        "log_scale": scale,
        "quat_left": left,
        "quat_right": right,
        "opacity_logit": np.log(opacity / (1 - opacity)),
        "sh": np.ascontiguousarray(sh),
    }
