"""The trajectories that the Gaussians of a scene share: how many, and with how many control points."""

from __future__ import annotations

from dataclasses import replace

import torch

from datasets.scene import Scene
from pipeline.model.model import Model
from rasterizer.trajectories import MAX_INTERVALS, Trajectories

TRAJECTORIES = 32
TIMES_PER_INTERVAL = 9  # training times for each interval of the finest splines


def with_trajectories(model: Model, scene: Scene) -> Model:
    """The model with still trajectories, which no Gaussian follows yet."""
    times = len({view.time for view in scene.train})
    intervals = min(max(round(times / TIMES_PER_INTERVAL), 2), MAX_INTERVALS)
    kind = replace(model.kind, trajectories=TRAJECTORIES)
    weights = torch.zeros(len(model), TRAJECTORIES)
    still = Trajectories.still(TRAJECTORIES, intervals, (scene.time_start, scene.time_end))
    return Model(kind, {**model.parameters, "weights": weights}, model.sphere, model.environment_map, still)
