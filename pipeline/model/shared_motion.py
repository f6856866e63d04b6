"""How many trajectories the Gaussians of a scene share, and how many control points these have."""

from __future__ import annotations

from dataclasses import replace

import torch

from datasets.scene import Scene
from pipeline.config.train_schema import TrainConfig
from pipeline.model.model import Model
from rasterizer.trajectories import MAX_INTERVALS, Trajectories

TIMES_PER_INTERVAL = 9  # training times for each interval of the finest splines


def with_trajectories(model: Model, scene: Scene, cfg: TrainConfig) -> Model:
    """The model with still trajectories, which no Gaussian follows yet."""
    times = len({view.time for view in scene.train})
    intervals = min(max(round(times / TIMES_PER_INTERVAL), 2), MAX_INTERVALS)
    kind = replace(model.kind, trajectories=cfg.trajectories)
    weights = torch.zeros(len(model), cfg.trajectories)
    still = Trajectories.still(cfg.trajectories, intervals, (scene.time_start, scene.time_end))
    return Model(kind, {**model.parameters, "weights": weights}, model.sphere, model.environment_map, still)
