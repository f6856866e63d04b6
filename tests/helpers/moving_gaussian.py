"""A Gaussian with a known motion, and a scene whose ground truth is that of a body with this motion."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from tiny import tiny_scene

from datasets.ground_truth import StoredTruth
from datasets.scene import Scene, View
from pipeline.model.model import Model, ModelKind
from rasterizer import Camera

VELOCITY, DEPTH, FOCAL, DT = 0.8, 4.0, 50.0, 0.1


def moving_gaussian(velocity: float) -> Model:
    """One Gaussian of width 0.3 with mean (velocity · t, 0, DEPTH) at time t, visible at all times.

    v -> u v u with u = cos(θ/2) + k sin(θ/2) turns the plane of x (the real part) and t (k) by θ and keeps y and z. The
    long axis of time becomes (-sin θ, cos θ), so that the velocity is -tan θ but for (0.3 / 300)² of it.
    """
    half = -0.5 * math.atan(velocity)
    turn = torch.tensor([[math.cos(half), 0.0, 0.0, math.sin(half)]])
    return Model(
        ModelKind("full", 0, 0),
        {
            "mean": torch.tensor([[0.0, 0.0, DEPTH, 0.0]]),
            "log_scale": torch.log(torch.tensor([[0.3, 0.3, 0.3, 300.0]])),
            "quat_left": turn,
            "quat_right": turn.clone(),
            "opacity_logit": torch.tensor([4.0]),
            "sh": torch.full((1, 1, 3), 1.0),
        },
    )


def scene_with_truth(folder: Path) -> Scene:
    """A test view at time 0, a disc moving right at VELOCITY at depth DEPTH, within what the Gaussian covers."""
    camera = Camera(32, 32, FOCAL, FOCAL, 16.0, 16.0, np.eye(4))
    x, y = np.meshgrid(np.arange(32) + 0.5, np.arange(32) + 0.5)
    disc = (x - 16) ** 2 + (y - 16) ** 2 < 25
    flow = np.zeros((2, 32, 32))
    flow[0, disc] = FOCAL * VELOCITY * DT / DEPTH
    np.savez(folder / "r_0.npz", moving=disc, depth=DEPTH * disc, flow=flow, flow_valid=disc, flow_dt=DT)
    image = np.zeros((32, 32, 3), np.uint8)
    return replace(tiny_scene(), test=(View(camera, 0.0, image, "test/r_0", None, StoredTruth(folder / "r_0.npz")),))
