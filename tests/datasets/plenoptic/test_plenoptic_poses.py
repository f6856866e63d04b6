"""poses_bounds.npy: axes, scale and bounds against hand-computed values and against an independent writer."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from datasets.files.errors import SceneError
from datasets.plenoptic.poses import read_poses
from datasets.synthetic.write_film import llff_row
from rasterizer.camera import Camera

SIZE = (640, 480)


def read(tmp_path: Path, *rows: np.ndarray, keep: tuple[str, ...] | None = None, size: tuple[int, int] = SIZE):
    names = tuple(f"cam{index:02d}" for index in range(len(rows)))
    np.save(tmp_path / "poses_bounds.npy", np.stack(rows))
    return read_poses(tmp_path / "poses_bounds.npy", names, keep or names, size)


def row(
    down: list, right: list, backwards: list, position: list, hwf: tuple = (480, 640, 500.0), bounds: tuple = (2.0, 8.0)
) -> np.ndarray:
    matrix = np.array([down, right, backwards, position, hwf], dtype=float).T  # its columns
    return np.concatenate([matrix.ravel(), bounds])


# Position (1, 2, 3), viewing direction +x, right +z, down -y.
SIDEWAYS = row(down=[0, -1, 0], right=[0, 0, 1], backwards=[-1, 0, 0], position=[1, 2, 3])


def pixel(camera: Camera, point: list[float]) -> tuple[float, float, float]:
    x, y, z, _ = camera.world_to_cam @ [*point, 1.0]
    return camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy, z


@pytest.mark.parametrize(
    ("point", "expected"),
    [
        ([6, 2, 3], (320, 240, 5)),  # straight ahead
        ([6, 2, 4], (320 + 500 / 5, 240, 5)),  # 1 to its right
        ([6, 1, 3], (320, 240 + 500 / 5, 5)),  # 1 below it
        ([11, 4, 5], (320 + 500 * 2 / 10, 240 - 500 * 2 / 10, 10)),
    ],
)
def test_projection_of_points(tmp_path: Path, point: list, expected: tuple) -> None:
    camera = read(tmp_path, SIDEWAYS).cameras["cam00"]
    assert pixel(camera, point) == pytest.approx(expected, abs=1e-9)
    np.testing.assert_allclose(camera.position, [1, 2, 3], atol=1e-12)


def test_round_trip_with_llff_row(tmp_path: Path) -> None:
    cameras = []
    for rotation in Rotation.random(5, rng=np.random.default_rng(0)).as_matrix():
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = rotation, (0.5, -2.0, 3.0)
        cameras.append(Camera(*SIZE, 432.1, 432.1, 320.0, 240.0, pose))
    found = read(tmp_path, *(llff_row(camera, 1.0, 9.0) for camera in cameras))
    for camera, back in zip(cameras, found.cameras.values()):
        np.testing.assert_allclose(back.world_to_cam, camera.world_to_cam, atol=1e-12)
        assert (back.width, back.height, back.fx, back.fy, back.cx, back.cy) == (*SIZE, 432.1, 432.1, 320.0, 240.0)


def test_focal_length_is_scaled_to_the_videos_size(tmp_path: Path) -> None:
    half = row([0, 1, 0], [1, 0, 0], [0, 0, -1], [0, 0, 0], (240, 320, 250.0))
    camera = read(tmp_path, half).cameras["cam00"]
    assert (camera.width, camera.height, camera.fx, camera.fy, camera.cx) == (*SIZE, 500.0, 500.0, 320.0)


def test_rounded_size_is_accepted(tmp_path: Path) -> None:
    third = row([0, 1, 0], [1, 0, 0], [0, 0, -1], [0, 0, 0], (480 / 3, 213, 100.0))  # 640 / 3 = 213.3
    assert read(tmp_path, third).cameras["cam00"].fx == pytest.approx(300, rel=2e-3)
    fatter = row([0, 1, 0], [1, 0, 0], [0, 0, -1], [0, 0, 0], (480 / 3, 216, 100.0))
    with pytest.raises(SceneError, match=r"row 0 \(cam00\): expected .* at another scale, found 216 x 160"):
        read(tmp_path, fatter)


def test_unit_and_init_box_follow_from_bounds(tmp_path: Path) -> None:
    far = SIDEWAYS.copy()
    far[15:] = 3.0, 30.0
    found = read(tmp_path, SIDEWAYS, far)
    assert found.unit == 1.5  # 0.75 · 2
    # x of the second camera's far bound is 1 + 30, its y and z stay 2 and 3: a cube of side 30 about (16, 2, 3).
    np.testing.assert_allclose(found.init_box, [(1, -13, -12), (31, 17, 18)])
    assert read(tmp_path, SIDEWAYS, far, keep=("cam01",)).unit == 2.25


def test_poses_of_other_cameras_are_not_checked(tmp_path: Path) -> None:
    found = read(tmp_path, np.full(17, np.nan), SIDEWAYS, keep=("cam01",))
    assert list(found.cameras) == ["cam01"]
