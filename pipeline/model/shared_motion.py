"""How many trajectories the Gaussians of a scene share, and how many control points these have."""

from __future__ import annotations

import math
from dataclasses import replace

import torch

from datasets.scene import Scene
from pipeline.config.train_schema import TrainConfig
from pipeline.model.model import Model
from rasterizer.trajectories import MAX_LEVELS, Trajectories

TIMES_PER_INTERVAL = 10  # training times for each interval of the finest splines, about


def with_trajectories(model: Model, scene: Scene, cfg: TrainConfig) -> Model:
    """The model with still trajectories, which no Gaussian follows yet."""
    times = len({view.time for view in scene.train})
    levels = min(max(round(math.log2(times / TIMES_PER_INTERVAL)), 1), MAX_LEVELS)
    kind = replace(model.kind, trajectories=cfg.trajectories)
    weights = torch.zeros(len(model), cfg.trajectories)
    still = Trajectories.still(cfg.trajectories, levels, (scene.time_start, scene.time_end))
    return Model(kind, {**model.parameters, "weights": weights}, model.sphere, model.environment_map, still)
