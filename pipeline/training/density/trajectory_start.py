"""The start of shared motion: which Gaussian follows which trajectories.

The first iterations train without motion: all weights are zero. Then an anchor is drawn for each trajectory, far from
the others on what is opaque, and every Gaussian follows the trajectories of the anchors around it. Training moves the
weights freely from there.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from scipy.spatial import cKDTree

from pipeline.config.random_streams import Stream, stream
from pipeline.config.schema import Config
from pipeline.model.model import Model
from pipeline.training.schedule import Passing, Phase
from pipeline.training.state import TrainState

START = 0.08  # of the iterations
OPAQUE = (0.3, 0.1, 0.02)  # least opacity of anchors: the first with FEWEST_OPAQUE Gaussians
FEWEST_OPAQUE = 2000
MAX_OPAQUE = 6000  # that anchors are drawn from, for run time
ISOLATED = 4.0  # × the median distance to the fifth neighbour: beyond it no anchor is drawn


class TrajectoryStart:
    """Once, after START of the schedule."""

    event = "start_trajectories"

    def __init__(self, cfg: Config) -> None:
        self._start, self._seed = Passing(math.ceil(START * cfg.train.iterations)), cfg.seed

    def due(self, iteration: int, clock: float) -> bool:
        return self._start.now(iteration, clock)

    def apply(self, state: TrainState, phase: Phase) -> dict[str, int]:
        model, rng = state.model, stream(self._seed, Stream.TRAJECTORIES)
        if model.trajectories is None or model.parameters["weights"].any():
            return {}
        points = opaque_points(model, rng)
        anchors = points[farthest_points(points, len(model.trajectories), rng)]
        weights = anchor_weights(model.parameters["mean"][:, :3].cpu().numpy(), anchors)
        model.parameters["weights"] = torch.from_numpy(weights).to(model.device)
        return {"anchors": len(anchors)}


def opaque_points(model: Model, rng: np.random.Generator) -> np.ndarray:
    """(n, 3) means of opaque Gaussians that have neighbours."""
    opacity = torch.sigmoid(model.parameters["opacity_logit"]).cpu().numpy()
    means = model.parameters["mean"][:, :3].cpu().numpy()
    least = next((least for least in OPAQUE if (opacity > least).sum() > FEWEST_OPAQUE), 0.0)
    points = means[opacity > least]
    if len(points) > MAX_OPAQUE:
        points = points[rng.choice(len(points), MAX_OPAQUE, replace=False)]
    distance = cKDTree(points).query(points, k=[min(6, len(points))])[0][:, 0]
    return points[distance <= ISOLATED * np.median(distance)]


def farthest_points(points: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """Indices (count,) of points (n, 3), each the farthest from those before it; the first is random."""
    chosen = [int(rng.integers(len(points)))]
    distance = np.linalg.norm(points - points[chosen[0]], axis=1)
    for _ in range(count - 1):
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return np.array(chosen)


def anchor_weights(means: np.ndarray, anchors: np.ndarray) -> np.ndarray:
    """(N, K) float32 weights of means (N, 3) for anchors (K, 3), of sum 1: exp(-d²/2r²), r the anchors' spacing."""
    squared = ((means[:, None] - anchors[None]) ** 2).sum(axis=2)
    between = np.sort(np.linalg.norm(anchors[:, None] - anchors[None], axis=2), axis=1)
    radius = max(float(between[:, 1:3].mean()), 1e-12) if len(anchors) > 1 else 1.0
    weights = np.exp(-(squared - squared.min(axis=1, keepdims=True)) / (2 * radius * radius))
    return (weights / weights.sum(axis=1, keepdims=True)).astype(np.float32)
