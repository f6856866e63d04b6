"""Files of poses of one's own: cameras, times, defaults, and what is wrong in one line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from datasets.cameras.pose_file import read_poses
from datasets.files.errors import SceneError
from rasterizer import Camera

POSE = [[1, 0, 0, 0.5], [0, 1, 0, 0.0], [0, 0, 1, 4.0], [0, 0, 0, 1]]  # NeRF's axes: looks along -z
DEFAULT = Camera(40, 30, 50.0, 52.0, 21.0, 14.0, np.eye(4))


def written(path: Path, content: object) -> Path:
    path.write_text(json.dumps(content))
    return path


def test_intrinsics_of_the_file_and_by_default(tmp_path: Path) -> None:
    frames = [{"transform_matrix": POSE, "time": 0.25}, {"transform_matrix": POSE}]
    (own, time), (_, none) = read_poses(
        written(tmp_path / "a.json", {"camera_angle_x": 1.0, "w": 100, "h": 80, "frames": frames}), DEFAULT
    )
    assert (time, none) == (0.25, None)
    assert (own.width, own.height) == (100, 80) and own.fx == pytest.approx(50 / np.tan(0.5))
    assert own.position == pytest.approx([0.5, 0.0, 4.0])
    assert own.world_to_cam[2, :3] == pytest.approx([0, 0, -1]), "looks along -z of the file"
    (like, _), _ = read_poses(written(tmp_path / "b.json", {"frames": frames}), DEFAULT)
    assert (like.width, like.fx, like.fy, like.cx, like.cy) == (40, 50.0, 52.0, 21.0, 14.0)
    (larger, _), _ = read_poses(written(tmp_path / "c.json", {"w": 80, "h": 60, "frames": frames}), DEFAULT)
    assert (larger.width, larger.fx, larger.fy, larger.cy) == (80, 100.0, 104.0, 28.0)


@pytest.mark.parametrize(
    "content, error",
    [
        ([], "expected an object with a list frames of at least one pose, found list"),
        ({"frames": []}, "expected an object with a list frames"),
        ({"frames": [{}]}, r"frames\[0\].* transform_matrix"),
        ({"frames": [{"transform_matrix": [[1]]}]}, r"frames\[0\]: transform_matrix: expected 4 x 4 numbers"),
        ({"frames": [{"transform_matrix": POSE, "time": "noon"}]}, r"frames\[0\]: time"),
        ({"w": 0, "frames": [{"transform_matrix": POSE}]}, "expected a size of at least one pixel, found 0 x 30"),
        ({"frames": [3]}, r"frames\[0\]: expected an object, found int"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, content: object, error: str) -> None:
    with pytest.raises(SceneError, match=error):
        read_poses(written(tmp_path / "poses.json", content), DEFAULT)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="poses.json: expected a file of poses, or orbit, found none"):
        read_poses(tmp_path / "poses.json", DEFAULT)
