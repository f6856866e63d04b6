"""The Gaussians training starts from (docs/method.md 2): random points in a cube, or those of structure from motion; and
where the scene has an open background, more on a sphere round it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from scipy.spatial import cKDTree

from datasets.scene import Scene
from pipeline.config.schema import Config
from pipeline.data.sfm.photograph import Reconstruction
from pipeline.model.model import Model, kind_of
from pipeline.model.sphere import sphere_points
from rasterizer import Camera

# 3DGS: squared distances are kept above this, so that coincident points still have a finite log scale.
MIN_SQUARED_DISTANCE = 1e-7

# A Gaussian of the sphere reaches about its distance to the next one, of 100,000 a hundredth of the radius.
SIGHT_MARGIN = 0.1

SH_C0 = 0.28209479177387814  # Y_00 = 1 / (2 √π)


def initialise(scene: Scene, cfg: Config, generator: np.random.Generator, cloud: Reconstruction | None = None) -> Model:
    """A fresh model of the kind the scene and the ablation ask for.

    Positions and colours are those of `cloud`; without one positions are uniform in the box `scene.init_box` (or the
    cube `train.init_box`³) and colours grey. Times are uniform over the scene's duration widened by
    `train.init_time_margin` × duration a side. Deterministic in `generator`.
    """
    points, sh_dc = _random_points(scene, cfg, generator) if cloud is None else (cloud.points, _sh_dc(cloud.colors))
    sphere = 0
    if cfg.effective_background_model == "sphere":
        cameras = list({view.camera.world_to_cam.tobytes(): view.camera for view in scene.train}.values())
        places = np.concatenate([points, [camera.position for camera in cameras]])
        around = sphere_points(cfg.init.sphere_points, *bounding_sphere(places, cfg.init.sphere_radius), generator)
        around = around[in_sight(around, cameras)]
        sphere = len(around)
        points, sh_dc = np.concatenate([points, around]), np.concatenate([sh_dc, _grey(sphere, generator)])
    margin = cfg.train.init_time_margin * scene.duration
    times = generator.uniform(scene.time_start - margin, scene.time_start + scene.duration + margin, size=len(points))
    model = from_points(points, times, sh_dc, scene, cfg)
    if cfg.effective_background_model != "sphere":
        return model
    return Model(model.kind, model.parameters, sphere=torch.arange(len(points)) >= len(points) - sphere)


def bounding_sphere(places: np.ndarray, reach: float) -> tuple[np.ndarray, float]:
    """(centre (3,), radius): the middle of the box round `places` (N, 3), `reach` times the farthest one's distance."""
    centre = 0.5 * (places.min(axis=0) + places.max(axis=0))
    return centre, reach * float(np.linalg.norm(places - centre, axis=1).max())


def in_sight(points: np.ndarray, cameras: Sequence[Camera]) -> np.ndarray:
    """(N,) bool: which points (N, 3) appear in some camera's image, or beside it by less than SIGHT_MARGIN of its size.

    What no training camera sees never has a gradient: it would stay as it is and cost memory and time.
    """
    seen = np.zeros(len(points), dtype=bool)
    for c in cameras:
        x, y, z = c.world_to_cam[:3, :3] @ points.T + c.world_to_cam[:3, 3:]
        with np.errstate(divide="ignore", invalid="ignore"):
            column, row = (c.fx * x / z + c.cx) / c.width, (c.fy * y / z + c.cy) / c.height
        low, high = -SIGHT_MARGIN, 1 + SIGHT_MARGIN
        seen |= (z > 0) & (column > low) & (column < high) & (row > low) & (row < high)
    return seen


def _random_points(scene: Scene, cfg: Config, generator: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Positions (N, 3) in the box, and colours as coefficients (N, 3)."""
    count = cfg.scene.init_points if cfg.train.init_points is None else cfg.train.init_points
    low, high = scene.init_box if cfg.train.init_box is None else cfg.train.init_box
    return generator.uniform(low, high, size=(count, 3)), _grey(count, generator)


def _grey(count: int, generator: np.random.Generator) -> np.ndarray:
    """(N, 3) coefficients: 3DGS's start for Blender scenes, grey (½ from 4DSH's offset) with a trace of noise."""
    return generator.uniform(0.0, 1.0 / 255.0, size=(count, 3))


def _sh_dc(colors: np.ndarray) -> np.ndarray:
    """(N, 3) uint8 -> coefficients of order 0, degree 0 that show these colours from everywhere, at all times."""
    return (colors / 255.0 - 0.5) / SH_C0


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
