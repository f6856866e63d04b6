"""One wrong position decides nothing; and where there is none, nothing changes to the bit."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from dnerf_folder import blender_pose
from layout_folders import write_nerfstudio
from layout_scenes import read
from test_canonical import RIGS, camera

from datasets.canonical import canonical_of, canonical_space
from datasets.outliers import GAP, inliers, without_outliers
from datasets.scene import ScenePoints, bounding_cube, camera_extent
from pipeline.config.schema import Config, InitConfig
from pipeline.data.prepare import given_points, name_outliers

RNG = np.random.default_rng(0)
ANGLE = np.linspace(0, 2 * np.pi, 24, endpoint=False)
ORDINARY = {
    "a ring": np.stack([np.cos(ANGLE), np.sin(ANGLE), 0 * ANGLE], axis=1),
    "a row": np.arange(30)[:, None] * [1.0, 0, 0],
    "a walk that begins slowly": np.geomspace(1e-3, 50, 300)[:, None] * [1.0, 0.2, 0],
    "a dome and its distant half": np.concatenate([RNG.normal(size=(40, 3)), 8 * RNG.normal(size=(40, 3))]),
    "five cameras": RNG.normal(size=(5, 3)),
    "a heavy tail": RNG.standard_t(2, size=(3000, 3)),
    "four cameras and a distant one": np.concatenate([RNG.normal(size=(3, 3)), [[1e4, 0, 0]]]),
    "a tripod": np.zeros((50, 3)),
    "two cameras that film": np.repeat(RNG.normal(size=(2, 3)), 100, axis=0),
    "a tripod that is carried away": np.concatenate([np.zeros((40, 3)), np.arange(1, 21)[:, None] * [0.1, 0, 0]]),
}


@pytest.mark.parametrize("name", ORDINARY)
def test_ordinary_positions_have_no_outliers(name: str) -> None:
    positions = ORDINARY[name]
    assert inliers(positions).all() and without_outliers(positions) is positions


@pytest.mark.parametrize("distance", [1e2, 1e4, 1e8])
@pytest.mark.parametrize("name", ["a ring", "a row", "five cameras", "a heavy tail"])
def test_what_lies_beyond_a_gap_is_an_outlier(name: str, distance: float) -> None:
    positions = ORDINARY[name]
    radius = np.linalg.norm(positions - np.median(positions, axis=0), axis=1).max()
    far = np.vstack([[2 * distance * radius, -distance * radius, 0], positions])
    assert inliers(far).tolist() == [False] + [True] * len(positions)
    filmed = np.repeat(far, 3, axis=0)  # frames of one camera are one position
    assert inliers(filmed).tolist() == [False] * 3 + [True] * 3 * len(positions)
    near = np.vstack([[0.5 * GAP * radius, 0, 0], positions])
    assert inliers(near).all()


@pytest.mark.parametrize("rig", RIGS)
def test_a_wrong_pose_changes_neither_centre_nor_unit_nor_extent(rig: str) -> None:
    """To the bit: the others decide alone."""
    cameras = RIGS[rig] if len(RIGS[rig]) >= 5 else RIGS[rig] + [camera((0.7, 0.2, 1.0), (0.7, 0.2, 9.0))]
    wrong = camera((4e3, -7e3, 1e3), (0, 0, 0))
    assert canonical_space([wrong, *cameras]) == canonical_space(cameras)
    assert camera_extent([wrong, *cameras]) == camera_extent(cameras)
    positions = np.stack([one.position for one in cameras])
    assert bounding_cube(np.vstack([positions, wrong.position])) == bounding_cube(positions)


def test_a_wrong_pose_is_named(tmp_path: Path) -> None:
    """The file's seventh image; of the others canonical coordinates are those without it."""
    file = write_nerfstudio(tmp_path) / "transforms.json"
    content = json.loads(file.read_text())
    content["frames"][6]["transform_matrix"] = blender_pose(3e4)
    file.write_text(json.dumps(content))
    scene, _ = read(tmp_path)
    lines: list[str] = []
    name_outliers(scene, lines.append)
    assert len(lines) == 1 and lines[0].startswith("cameras: train/frame_00007 (1 of 12 views) far beyond the others")
    unit = canonical_of(scene).unit
    del content["frames"][6]
    file.write_text(json.dumps(content))
    assert unit == pytest.approx(canonical_of(read(tmp_path)[0]).unit, rel=0.1)  # another view is held out


def test_points_beyond_and_points_of_other_coordinates_are_left_out(tmp_path: Path) -> None:
    """Of 300 points about the scene one far away; and all of them a thousand units off."""
    scene, _ = read(write_nerfstudio(tmp_path))
    positions = np.random.default_rng(0).normal(size=(300, 3)) * 0.3
    positions[7] = 1e5, 0, 0
    colors = np.arange(900, dtype=np.uint8).reshape(300, 3)
    cfg, lines = replace(Config(), init=InitConfig(min_points=100)), []
    cloud = given_points(cfg, replace(scene, points=ScenePoints(positions, colors)), lines.append)
    assert cloud is not None and lines == ["points: 1 of 300 lie far beyond the others and are left out"]
    kept = np.arange(300) != 7
    assert np.array_equal(cloud.points, positions[kept]) and np.array_equal(cloud.colors, colors[kept])
    near = replace(scene, points=ScenePoints(positions[kept], colors[kept]))
    cloud = given_points(cfg, near, lines.append)
    assert cloud is not None and cloud.points is near.points.positions and len(lines) == 1
    away = replace(scene, points=ScenePoints(positions[kept] + [1e3, 0, 0], colors[kept]))
    assert given_points(cfg, away, lines.append) is None
    assert lines[1].startswith("points: 0 % of 299 are before a camera, as if not in the coordinates of")


@pytest.mark.parametrize("count, wrong", [(12, 2), (11, 3), (100, 12)])
def test_several_wrong_poses(count: int, wrong: int) -> None:
    """Each far away by itself."""
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
    positions = np.stack([3 * np.cos(angle), 3 * np.sin(angle), 0 * angle], axis=1)
    positions[1 : 1 + wrong] += np.arange(1, wrong + 1)[:, None] * [900.0, 50.0, -400.0]
    assert (~inliers(positions)).nonzero()[0].tolist() == list(range(1, 1 + wrong))
