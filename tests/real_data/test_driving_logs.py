"""Real driving logs: DATA_DIR/kitti/odometry holds sequences/04 and poses/04.txt, DATA_DIR/waymo_v2 a component."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from kitti_folder import frames_of
from kitti_format import write_kitti_format

from datasets.readers.kitti import open_kitti
from datasets.readers.waymo import open_waymo
from datasets.settings import SceneConfig
from datasets.urban.assemble import scene_of_log
from datasets.urban.log import DrivingLog
from datasets.urban.projection import depth_image
from datasets.urban.waymo.components import Components, vehicle_poses
from datasets.urban.write import write_processed

pytestmark = pytest.mark.data
FRAMES = 4


def folder(name: str) -> Path:
    path = Path(os.environ["DATA_DIR"]) / name
    if not path.exists():
        pytest.skip(f"{path}: no such data")
    return path


@pytest.fixture(scope="module")
def kitti() -> DrivingLog:
    return open_kitti(folder("kitti/odometry/sequences/04"))


@pytest.mark.parametrize("layout", ["processed14", "processed10", "kitti_format"])
def test_a_real_clip_survives_each_layout(layout: str, kitti: DrivingLog, tmp_path: Path) -> None:
    """To 1e-4: sweeps are float32 within 100 m of the car."""
    images = tuple(image for image in kitti.images if image.frame < FRAMES and image.number in (2, 3))
    sweeps = tuple(sweep for sweep in kitti.sweeps if sweep.frame < FRAMES)
    log = DrivingLog(kitti.layout, kitti.source, images, sweeps, kitti.usual_cameras)
    vehicle = [np.linalg.inv(image.camera.world_to_cam) for image in images if image.number == 2]
    # Waymo's vehicle axes are x forward, y left, z up: those of camera 2, turned.
    axes = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
    for index, frame in enumerate(frames_of(log, [pose @ axes for pose in vehicle], {2: 0, 3: 1})):
        if layout == "kitti_format":
            write_kitti_format(tmp_path, index, frame)
        else:
            write_processed(tmp_path, index, frame, int(layout.removeprefix("processed")))
    found = open_waymo(tmp_path)
    by_key = {(image.number, image.frame): image for image in found.images}
    for image in images:
        other = by_key[image.number - 2, image.frame].camera
        np.testing.assert_allclose(other.world_to_cam, image.camera.world_to_cam, atol=1e-4)
        assert (other.fx, other.fy, other.cx, other.cy) == (
            image.camera.fx, image.camera.fy, image.camera.cx, image.camera.cy
        )  # fmt: skip
    for one, two in zip(sweeps, found.sweeps):
        np.testing.assert_allclose(two.read().points, one.read().points, atol=1e-4)


def test_lidar_lies_on_what_the_camera_sees(kitti: DrivingLog) -> None:
    """The next frame's sweep, moved by the poses, projects to the depths of this frame's: the road does not move."""
    scene = scene_of_log(kitti, SceneConfig(name="kitti/04", reader="kitti", frames=8, test_every=4))
    sweeps = {sweep.frame: sweep for sweep in scene.sweeps}
    view = next(view for view in scene.train if view.frame == 0)
    now, later = depth_image(sweeps[0].points, view.camera), depth_image(sweeps[1].points, view.camera)
    both = (now > 0) & (later > 0)
    assert both.sum() > 1000 and np.median(np.abs(now[both] / later[both] - 1)) < 0.02


def test_the_schema_of_a_real_component() -> None:
    for file in (folder("waymo_v2") / "vehicle_pose").glob("*.parquet"):
        poses = vehicle_poses(Components(file.parent.parent, file.stem))
        assert len(poses) > 100 and sorted(poses) == list(poses)
