"""Initialisation: the values of docs/method.md 2, recomputed naively."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tiny import tiny_scene

from datasets.scene import Scene
from datasets.settings import SceneConfig
from pipeline.config.schema import AblationConfig, Config, InitConfig
from pipeline.config.train_schema import TrainConfig
from pipeline.data.sfm.reconstruction import Reconstruction
from pipeline.model.initialise import from_points, initialise, nearest_distance
from pipeline.model.sphere import sphere_points
from rasterizer.reference.sh import sh_basis


def config(**train_keys) -> Config:
    return Config(train=TrainConfig(**{"init_points": 500} | train_keys))


def test_spatial_scale_against_brute_force() -> None:
    points = np.random.default_rng(0).normal(size=(40, 3))
    squared = np.sort(((points[:, None] - points[None]) ** 2).sum(-1), axis=1)[:, 1:4]
    np.testing.assert_allclose(nearest_distance(points), np.sqrt(squared.mean(1)), rtol=1e-12)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_spatial_scale_of_few_and_coincident_points_is_finite(count: int) -> None:
    scale = nearest_distance(np.zeros((count, 3)))
    np.testing.assert_allclose(scale, np.sqrt(1e-7))


def test_values_of_a_dynamic_scene() -> None:
    scene = tiny_scene()
    p = initialise(scene, config(init_time_scale=0.5), np.random.default_rng(0)).parameters
    assert len(p["mean"]) == 500
    xyz, t = p["mean"][:, :3], p["mean"][:, 3]
    assert xyz.min() >= -1.2 and xyz.max() <= 1.2 and xyz.std() == pytest.approx(2.4 / 12**0.5, rel=0.05)
    assert t.min() >= 0 and t.max() <= 1 and t.std() == pytest.approx(1 / 12**0.5, rel=0.1)
    assert torch.allclose(p["log_scale"][:, 3].exp(), torch.tensor(0.5))
    assert torch.equal(p["log_scale"][:, 0], p["log_scale"][:, 2])
    assert torch.allclose(torch.sigmoid(p["opacity_logit"]), torch.tensor(0.1))
    identity = torch.tensor([1.0, 0, 0, 0]).expand(500, 4)
    assert torch.equal(p["quat_left"], identity) and torch.equal(p["quat_right"], identity)
    assert p["sh"][:, 0].min() >= 0 and 0 < p["sh"][:, 0].max() <= 1 / 255
    assert not p["sh"][:, 1:].any()


def test_time_margin_widens_both_sides() -> None:
    t = initialise(tiny_scene(), config(init_time_margin=0.1), np.random.default_rng(0)).parameters["mean"][:, 3]
    assert -0.1 <= t.min() < -0.05 and 1.05 < t.max() <= 1.1


def test_static_scene_stores_no_time() -> None:
    p = initialise(tiny_scene(static=True), config(), np.random.default_rng(0)).parameters
    assert p["mean"].shape == (500, 3) and p["log_scale"].shape == (500, 3) and p["sh"].shape == (500, 16, 3)
    assert "quat_right" not in p


def test_the_model_is_a_function_of_the_rng() -> None:
    one, two, other = (initialise(tiny_scene(), config(), np.random.default_rng(s)).parameters for s in (3, 3, 4))
    assert all(torch.equal(one[name], two[name]) for name in one)
    assert not torch.equal(one["mean"], other["mean"])


@pytest.mark.parametrize("points, found", [(np.zeros((0, 3)), "empty point cloud"), (np.full((5, 3), np.nan), "NaN")])
def test_invalid_point_clouds_are_refused_in_one_line(points: np.ndarray, found: str) -> None:
    cfg = Config(ablation=AblationConfig())
    with pytest.raises(ValueError, match=found) as error:
        from_points(points, np.zeros(len(points)), np.zeros((len(points), 3)), tiny_scene(), cfg)
    assert "\n" not in str(error.value) and "tiny" in str(error.value)


def cloud_of(points: np.ndarray, colors: np.ndarray) -> Reconstruction:
    ones = np.ones(len(points))
    return Reconstruction(points, colors, ones, 3 * ones, {}, "known", 3, 1.0)


def test_points_of_structure_from_motion_keep_their_positions_and_colours() -> None:
    """The Gaussian of a point has the point's colour from every direction and at any time."""
    scene, rng = tiny_scene(), np.random.default_rng(3)
    points, colors = rng.normal(size=(50, 3)), rng.integers(0, 256, (50, 3), dtype=np.uint8)
    model = initialise(scene, config(), np.random.default_rng(0), cloud_of(points, colors))
    np.testing.assert_allclose(model.parameters["mean"][:, :3], points, rtol=1e-6)
    color = 0.5 + sh_basis(torch.tensor([[0.6, 0.0, 0.8]]), 0)[0, 0] * model.parameters["sh"][:, 0]
    np.testing.assert_allclose(color, colors / 255, atol=1e-6)
    assert not model.parameters["sh"][:, 1:].any()
    t = model.parameters["mean"][:, 3]
    assert t.min() >= 0 and t.max() <= 1 and t.std() > 0.2  # over the whole duration
    assert model.sphere is None


def test_the_sphere_surrounds_the_scene_in_visible_directions_only() -> None:
    scene = tiny_scene()  # cameras on an arc at distance 4 from the origin, looking along +z
    cfg = Config(
        scene=SceneConfig(background_model="sphere"),
        init=InitConfig(sphere_points=4000),
        train=TrainConfig(init_points=50),
    )
    model = initialise(scene, cfg, np.random.default_rng(0))
    labelled, xyz = model.sphere, model.parameters["mean"][:, :3].double().numpy()
    assert not labelled[:50].any() and labelled[50:].all()
    positions = np.concatenate([xyz[:50], [view.camera.position for view in scene.train]])
    centre = (positions.min(axis=0) + positions.max(axis=0)) / 2
    radius = np.linalg.norm(positions - centre, axis=1).max()
    np.testing.assert_allclose(np.linalg.norm(xyz[50:] - centre, axis=1), 10 * radius, rtol=1e-5)
    # Of the whole sphere, the points in at least one image enlarged by a tenth; a naive loop.
    whole = sphere_points(4000, centre, 10 * radius, _after_points(scene, cfg))
    kept = []
    for point in whole:
        for view in scene.train:
            c = view.camera
            x, y, z = c.world_to_cam[:3, :3] @ point + c.world_to_cam[:3, 3]
            if z > 0 and abs(c.fx * x / z) < 0.6 * c.width and abs(c.fy * y / z) < 0.6 * c.height:
                kept.append(point)
                break
    assert 50 < len(kept) < 1000
    np.testing.assert_allclose(xyz[50:], kept, rtol=1e-5, atol=1e-4)


def _after_points(scene: Scene, cfg: Config) -> np.random.Generator:
    """The rng after the draws of the random points and their colours."""
    rng = np.random.default_rng(0)
    rng.uniform(size=(cfg.train.init_points, 3))
    rng.uniform(size=(cfg.train.init_points, 3))
    return rng
