"""The Gaussians training starts from (SPEC 2): random points in a cube, as D-NeRF scenes have no point cloud."""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial import cKDTree

from datasets.scene import Scene
from pipeline.config import Config
from pipeline.model import Model, kind_of

# 3DGS: squared distances are kept above this, so that coincident points still have a finite log scale.
MIN_SQUARED_DISTANCE = 1e-7


def initialise(scene: Scene, cfg: Config, generator: np.random.Generator) -> Model:
    """A fresh model of the kind the scene and the ablation ask for.

    Positions are uniform in the cube `scene.init_box`³ (or `train.init_box`³), times uniform over the scene's
    duration widened by `train.init_time_margin` × duration a side. Deterministic in `generator`.
    """
    count = cfg.scene.init_points if cfg.train.init_points is None else cfg.train.init_points
    low, high = scene.init_box if cfg.train.init_box is None else cfg.train.init_box
    points = generator.uniform(low, high, size=(count, 3))
    margin = cfg.train.init_time_margin * scene.duration
    times = generator.uniform(scene.time_start - margin, scene.time_start + scene.duration + margin, size=count)
    # 3DGS's start for Blender scenes: grey (½ from 4DSH's offset) with a trace of noise.
    sh_dc = generator.uniform(0.0, 1.0 / 255.0, size=(count, 3))
    return from_points(points, times, sh_dc, scene, cfg)


def from_points(
    points: np.ndarray,  # (N, 3) world units
    times: np.ndarray,  # (N,) the scene's time unit; ignored by a static model
    sh_dc: np.ndarray,  # (N, 3) order-0, degree-0 coefficients
    scene: Scene,
    cfg: Config,
) -> Model:
    """Isotropic Gaussians at the points, unrotated. Raises ValueError for an empty or non-finite point cloud."""
    if len(points) == 0:
        raise ValueError(f"{scene.source}: expected at least 1 initial point, found an empty point cloud")
    if not (np.isfinite(points).all() and np.isfinite(times).all()):
        raise ValueError(f"{scene.source}: expected finite initial points, found NaN or Inf")
    kind, count = kind_of(scene, cfg), len(points)
    parameters = {name: torch.zeros(count, *row) for name, row in kind.shapes().items()}

    parameters["mean"][:, :3] = torch.from_numpy(points)
    parameters["log_scale"][:, :3] = torch.from_numpy(np.log(nearest_distance(points)))[:, None]
    if kind.dims == 4:
        parameters["mean"][:, 3] = torch.from_numpy(times)
        parameters["log_scale"][:, 3] = float(np.log(cfg.train.init_time_scale * scene.duration))
    for name in ("quat_left", "quat_right"):
        if name in parameters:
            parameters[name][:, 0] = 1.0
    opacity = cfg.train.init_opacity
    parameters["opacity_logit"].fill_(float(np.log(opacity / (1.0 - opacity))))
    parameters["sh"][:, 0] = torch.from_numpy(sh_dc)
    return Model(kind, parameters)


def nearest_distance(points: np.ndarray) -> np.ndarray:
    """(N, 3) -> (N,): root of the mean squared distance to the 3 nearest other points, as 3DGS's simple-knn.

    With fewer than 4 points the mean is over those there are; a lone point gets the floor.
    """
    neighbours = min(3, len(points) - 1)
    if neighbours == 0:
        return np.full(len(points), np.sqrt(MIN_SQUARED_DISTANCE))
    distances, _ = cKDTree(points).query(points, k=neighbours + 1)
    squared = np.square(distances[:, 1:]).mean(axis=1)  # column 0 is the point itself
    return np.sqrt(np.maximum(squared, MIN_SQUARED_DISTANCE))
