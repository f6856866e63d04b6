"""prepare(): points from structure from motion, refined poses, canonical coordinates."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from tiny import tiny_config

from datasets.canonical import canonical_of
from datasets.settings import SceneConfig
from datasets.source import open_source
from datasets.synthetic import build_scene
from pipeline.config.schema import Config, InitConfig
from pipeline.data.from_motion import near_depth
from pipeline.data.prepare import Prepared, points_from, prepare
from rasterizer import Camera


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("prepare") / "scene"
    return build_scene(folder, scene="counter", seed=2, size=160, cameras=5, frames=2)


def prepared(folder: Path, **init) -> Prepared:
    cfg = Config(
        scene=SceneConfig(
            name="plenoptic", reader="plenoptic", path=str(folder), downscale=2, cache=str(folder.parent / "cache")
        ),
        init=InitConfig(min_points=10, max_features=1000, **init),
        threads=1,
    )
    return prepare(cfg, lambda line: None)


def test_points_come_from_full_size_frames(folder: Path) -> None:
    data = prepared(folder)
    assert data.scene.train[0].camera.width == 80
    assert all(found.camera.width == 160 for found in data.cloud.cameras.values())
    assert set(data.cloud.cameras) == {"cam01", "cam02", "cam03", "cam04"}  # cam00 is held out
    assert (data.sfm_folder / "sfm.png").is_file()


def test_training_photographs(folder: Path) -> None:
    posed = open_source(SceneConfig("counter", "plenoptic", str(folder)), log=print)
    photographs = posed.photographs()
    assert [p.name for p in photographs] == ["cam01", "cam02", "cam03", "cam04"]  # cam00 is held out
    for photograph in photographs:
        np.testing.assert_array_equal(photograph.image, posed.footage.first_images()[photograph.name])
        assert photograph.camera is posed.cameras[photograph.name]


def test_random_points_skip_structure_from_motion(folder: Path) -> None:
    data = prepared(folder, source="random")
    assert data.cloud is None and data.sfm_folder is None and len(data.scene.train) == 8


def test_refined_poses_replace_training_poses(folder: Path) -> None:
    given, refined = prepared(folder), prepared(folder, refine_poses=True)
    for before, after in zip(given.scene.train, refined.scene.train):
        name = after.name.removeprefix("train/")[:5]
        pose = refined.cloud.cameras[name].camera.world_to_cam
        np.testing.assert_array_equal(after.camera.world_to_cam, pose)
        assert 0 < np.abs(pose - before.camera.world_to_cam).max() < 0.05
    for before, after in zip(given.scene.test, refined.scene.test):  # held-out poses are not refined
        np.testing.assert_array_equal(after.camera.world_to_cam[:3, :3], before.camera.world_to_cam[:3, :3])
        np.testing.assert_allclose(
            refined.canonical.inverse.points(after.camera.position),
            given.canonical.inverse.points(before.camera.position),
            atol=1e-12,
        )


def test_poses_that_nothing_refines_are_said_to_be_kept(folder: Path) -> None:
    with pytest.raises(ValueError, match=r"init.refine_poses: expected false for .*, whose poses are kept, found true"):
        prepared(folder, source="random", refine_poses=True)


def test_result_is_in_canonical_coordinates(folder: Path) -> None:
    data = prepared(folder)
    assert not data.canonical.is_identity  # the rig is at distance 3
    positions = np.unique([view.camera.position for view in data.scene.train], axis=0)
    assert np.linalg.norm(positions, axis=1).mean() == pytest.approx(4.0)
    for camera in (found.camera for found in data.cloud.cameras.values()):  # points in front of all cameras
        depths = data.cloud.points @ camera.world_to_cam[2, :3] + camera.world_to_cam[2, 3]
        assert 1 < np.median(depths) < 10 and (depths > 0).all()
    assert canonical_of(data.scene).is_identity


@pytest.mark.parametrize(("scale", "shift"), [(1e3, 0.0), (1e-3, 0.0), (1.0, 1e4)])
def test_result_is_independent_of_unit_and_origin(folder: Path, tmp_path: Path, scale: float, shift: float) -> None:
    """Also the result of COLMAP, whose solvers have absolute tolerances."""
    other = shutil.copytree(folder, tmp_path / "other")
    rows = np.load(other / "poses_bounds.npy")
    rows[:, 3:15:5] = rows[:, 3:15:5] * scale + shift  # the position: the fourth column of five
    rows[:, 15:] *= scale
    np.save(other / "poses_bounds.npy", rows)
    one, two = prepared(folder), prepared(other)
    for a, b in zip(one.scene.train + one.scene.test, two.scene.train + two.scene.test):
        np.testing.assert_allclose(b.camera.world_to_cam, a.camera.world_to_cam, atol=1e-9)
        assert b.time == a.time
    assert two.scene.unit == pytest.approx(one.scene.unit) and two.scene.extent == pytest.approx(one.scene.extent)
    np.testing.assert_allclose(two.cloud.points, one.cloud.points, atol=1e-6)
    np.testing.assert_array_equal(two.cloud.colors, one.cloud.colors)


@pytest.mark.parametrize("reader", ["dnerf", "synthetic"])
def test_lidar_is_refused_where_there_is_none(reader: str) -> None:
    cfg = Config(scene=SceneConfig(name="synthetic/wheel", reader=reader, path="x"), init=InitConfig(source="lidar"))
    with pytest.raises(ValueError, match="init.source: expected auto, random or sfm for a scene without LiDAR"):
        prepare(cfg, print)


def test_a_sphere_around_lidar_points_is_refused() -> None:
    source = SimpleNamespace(points="lidar", poses="given", several_videos=False, path="log")
    cfg = replace(tiny_config(background_model="sphere"), init=InitConfig())
    with pytest.raises(
        ValueError, match="scene.background_model: expected cubemap, envmap or none for log, .* found sphere"
    ):
        points_from(cfg, source)
    assert points_from(replace(cfg, init=InitConfig(source="random")), source) == "random"


def test_near_depth_is_the_5_percent_quantile() -> None:
    points = np.stack([np.zeros(101), np.zeros(101), np.linspace(1, 101, 101)], axis=1)
    points = np.concatenate([points, [[0, 0, -5]]])  # behind the camera, not counted
    assert near_depth(points, [Camera(8, 8, 8, 8, 4, 4, np.eye(4))]) == pytest.approx(6.0)
