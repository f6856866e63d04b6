"""Initialisation of the Gaussians (docs/method.md 2): random points in a box or a point cloud from structure from
motion, and, with scene.background_model=sphere, points on a sphere around the scene."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from scipy.spatial import cKDTree

from datasets.outliers import without_outliers
from datasets.scene import Scene, ScenePoints
from pipeline.config.schema import Config
from pipeline.data.lidar.initial_points import initial_points
from pipeline.data.sfm.reconstruction import Reconstruction
from pipeline.model.model import Model, kind_of
from pipeline.model.sphere import sphere_points
from pipeline.model.transformed import rotations_of
from rasterizer import Camera, Gaussians
from rasterizer.covariance import scaled_axes

# 3DGS: lower bound of squared distances, so that coincident points have a finite log scale.
MIN_SQUARED_DISTANCE = 1e-7

# Of the image size. A Gaussian of the sphere is about as large as the distance to its neighbour, with 100,000 of them a
# hundredth of the radius.
IMAGE_MARGIN = 0.1

INITIAL_OPACITY = 0.1  # of every Gaussian, as 3DGS

# Of the background sphere, as in the paper; × the distance of the farthest camera or point from the scene's centre.
SPHERE_RADIUS = 10.0

SH_C0 = 0.28209479177387814  # Y_00 = 1 / (2 √π)


def initialise(scene: Scene, cfg: Config, rng: np.random.Generator, cloud: Reconstruction | None = None) -> Model:
    """A new model of the kind that scene and ablation determine.

    Positions and colours are those of `cloud`. A driving log with LiDAR starts from its sweeps, which also give the
    times (pipeline/data/lidar/initial_points.py), unless `init.source` says otherwise. Without points, and beside
    sparse ones, positions are uniform in `Scene.init_box` and colours grey. Times are uniform over the scene's
    duration, widened by `train.init_time_margin` × duration on each side. Deterministic in `rng`.
    """
    if cloud is None and scene.sweeps and cfg.init.source in ("auto", "lidar"):
        budget = cfg.init.lidar_points or max(1, cfg.train.densify.max_gaussians // 2)
        start = initial_points(scene, budget, rng, cfg.init.lidar_velocities)
        model = from_points(start.points, start.times, _sh_dc(start.colors), scene, cfg)
        set_velocities(model, start.velocities)
        return model
    if scene.points is not None and scene.points.times is not None:
        return from_timed_points(scene.points, scene, cfg)
    points, sh_dc = (np.zeros((0, 3)),) * 2 if cloud is None else (cloud.points, _sh_dc(cloud.colors))
    if cloud is None or (scene.points is not None and scene.points.sparse):
        random, grey = _random_points(scene, cfg.train.init_points - len(points), rng)
        points, sh_dc = np.concatenate([points, random]), np.concatenate([sh_dc, grey])
    n_sphere = 0
    if cfg.scene.background_model == "sphere":
        cameras = list({view.camera.world_to_cam.tobytes(): view.camera for view in scene.train}.values())
        positions = np.concatenate([points, [camera.position for camera in cameras]])
        centre, radius = bounding_sphere(positions, SPHERE_RADIUS)
        on_sphere = sphere_points(cfg.init.sphere_points, centre, radius, rng)
        on_sphere = on_sphere[visible_in_any(on_sphere, cameras)]
        n_sphere = len(on_sphere)
        points, sh_dc = np.concatenate([points, on_sphere]), np.concatenate([sh_dc, _grey(n_sphere, rng)])
    margin = cfg.train.init_time_margin * scene.duration
    times = rng.uniform(scene.time_start - margin, scene.time_start + scene.duration + margin, size=len(points))
    model = from_points(points, times, sh_dc, scene, cfg)
    if cfg.scene.background_model != "sphere":
        return model
    return Model(model.kind, model.parameters, sphere=torch.arange(len(points)) >= len(points) - n_sphere)


def bounding_sphere(positions: np.ndarray, factor: float) -> tuple[np.ndarray, float]:
    """(centre (3,), radius), world units: the centre of the bounding box of `positions` (N, 3), and `factor` times the
    largest distance from it; of those that are no outliers."""
    positions = without_outliers(positions)
    centre = 0.5 * (positions.min(axis=0) + positions.max(axis=0))
    return centre, factor * float(np.linalg.norm(positions - centre, axis=1).max())


def visible_in_any(points: np.ndarray, cameras: Sequence[Camera]) -> np.ndarray:
    """(N,) bool: which points (N, 3) project into the image of at least one camera, enlarged by IMAGE_MARGIN a side.

    The others would never have a gradient, and would cost memory and time.
    """
    visible = np.zeros(len(points), dtype=bool)
    for c in cameras:
        x, y, z = c.world_to_cam[:3, :3] @ points.T + c.world_to_cam[:3, 3:]
        with np.errstate(divide="ignore", invalid="ignore"):
            column, row = (c.fx * x / z + c.cx) / c.width, (c.fy * y / z + c.cy) / c.height
        low, high = -IMAGE_MARGIN, 1 + IMAGE_MARGIN
        visible |= (z > 0) & (column > low) & (column < high) & (row > low) & (row < high)
    return visible


def _random_points(scene: Scene, count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Positions (N, 3), world units, and SH coefficients of degree 0 (N, 3); none for a count below 1."""
    count = max(0, count)
    if scene.init_depths is not None:
        return _before_cameras([view.camera for view in scene.train], scene.init_depths, count, rng), _grey(count, rng)
    low, high = (np.broadcast_to(np.asarray(corner, np.float64), 3) for corner in scene.init_box)
    return rng.uniform(low, high, size=(count, 3)), _grey(count, rng)


def _before_cameras(
    cameras: Sequence[Camera], depths: tuple[float, float], count: int, rng: np.random.Generator
) -> np.ndarray:
    """(N, 3) in random pixels of random cameras, the logarithm of the depth uniform between `depths`."""
    of = rng.integers(len(cameras), size=count)
    place, depth = rng.random((count, 2)), np.exp(rng.uniform(np.log(depths[0]), np.log(depths[1]), size=count))
    lens = np.array([(c.width / c.fx, c.cx / c.fx, c.height / c.fy, c.cy / c.fy) for c in cameras])[of]
    x, y = place[:, 0] * lens[:, 0] - lens[:, 1], place[:, 1] * lens[:, 2] - lens[:, 3]
    to_world = np.stack([np.linalg.inv(c.world_to_cam) for c in cameras])
    points = depth[:, None] * np.stack([x, y, np.ones(count)], axis=1)
    return np.einsum("nij,nj->ni", to_world[of, :3, :3], points) + to_world[of, :3, 3]


def _grey(count: int, rng: np.random.Generator) -> np.ndarray:
    """(N, 3) SH coefficients of degree 0, as 3DGS for Blender scenes: near 0, which is grey, with a little noise."""
    return rng.uniform(0.0, 1.0 / 255.0, size=(count, 3))


def _sh_dc(colors: np.ndarray) -> np.ndarray:
    """(N, 3) uint8 RGB -> SH coefficients of order 0, degree 0: these colours at any time, in any direction."""
    return (colors / 255.0 - 0.5) / SH_C0


def from_points(
    points: np.ndarray,  # (N, 3) world units
    times: np.ndarray,  # (N,) in the scene's unit of time; unused by a static model
    sh_dc: np.ndarray,  # (N, 3) order-0, degree-0 coefficients
    scene: Scene,
    cfg: Config,
) -> Model:
    """Isotropic, unrotated Gaussians at the points. Raises ValueError for an empty or non-finite point cloud."""
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
    parameters["opacity_logit"].fill_(float(np.log(INITIAL_OPACITY / (1.0 - INITIAL_OPACITY))))
    parameters["sh"][:, 0] = torch.from_numpy(sh_dc)
    return Model(kind, parameters)


def from_timed_points(found: ScenePoints, scene: Scene, cfg: Config) -> Model:
    """Of points with times: each as large as the distance to those of its time, what is always there lasts as long as
    the scene."""
    assert found.times is not None
    always = np.isnan(found.times)
    model = from_points(
        found.positions, np.where(always, scene.time_start, found.times), _sh_dc(found.colors), scene, cfg
    )
    for time in np.unique(found.times):  # NaN once
        rows = np.flatnonzero(always if np.isnan(time) else found.times == time)
        size = np.log(nearest_distance(found.positions[rows]))
        model.parameters["log_scale"][rows, :3] = torch.from_numpy(size).float()[:, None]
    if model.kind.dims == 4:
        model.parameters["mean"][always, 3] = float(scene.time_start + 0.5 * scene.duration)
        spans = np.where(always, scene.duration, found.span)
        model.parameters["log_scale"][:, 3] = torch.from_numpy(np.log(spans)).float()
    return model


def set_velocities(model: Model, velocities: np.ndarray) -> None:
    """Let unrotated Gaussians move, in place: their temporal scales and their spatial covariances at any time stay.

    velocities: (N, 3), world units per unit of time. A model without 4D rotation is unchanged.
    """
    moving = torch.from_numpy(np.flatnonzero(np.abs(velocities).max(axis=1, initial=0.0) > 0))
    if model.kind.motion != "full" or not len(moving):
        return
    rows = {name: tensor[moving] for name, tensor in model.parameters.items() if name != "quat_right"}
    rows["velocity"] = torch.from_numpy(velocities)[moving].float()
    for name, values in rotations_of(scaled_axes(Gaussians.from_tensors(rows).to(torch.float64))).items():
        model.parameters[name][moving] = values


def nearest_distance(points: np.ndarray) -> np.ndarray:
    """(N, 3) -> (N,): root mean squared distance to the 3 nearest other points, as 3DGS's simple-knn.

    With fewer than 4 points the mean is over all others; for a single point it is the root of MIN_SQUARED_DISTANCE.
    """
    neighbours = min(3, len(points) - 1)
    if neighbours == 0:
        return np.full(len(points), np.sqrt(MIN_SQUARED_DISTANCE))
    distances, _ = cKDTree(points).query(points, k=neighbours + 1)
    squared = np.square(distances[:, 1:]).mean(axis=1)  # column 0 is the point itself
    return np.sqrt(np.maximum(squared, MIN_SQUARED_DISTANCE))
