"""Waymo's layouts: a log written in each of them and read back is the same; what fits none is refused."""

from __future__ import annotations

from pathlib import Path

import kitti_folder as k
import numpy as np
import pytest
from kitti_format import write_kitti_format
from PIL import Image

from datasets.files.errors import SceneError
from datasets.readers.kitti import open_kitti
from datasets.readers.waymo import open_waymo
from datasets.settings import SceneConfig
from datasets.source import open_source
from datasets.urban.assemble import scene_of_log
from datasets.urban.log import DrivingLog
from datasets.urban.waymo.processed import columns_of
from datasets.urban.write import Frame, FrameCamera, write_processed
from rasterizer.camera import Camera

NUMBERS = {2: 0, 3: 1}  # KITTI's cameras -> Waymo's
TOLERANCE = 1e-4  # sweeps are float32 within 100 m of the car: 8e-6 m; the rest is float64


def velo_to_world(frame: int) -> np.ndarray:
    return k.cam0_to_world(frame) @ k.VELO_TO_CAM


def written(layout: str, root: Path) -> tuple[DrivingLog, DrivingLog]:
    """(a KITTI log, the same read from a Waymo layout)."""
    log = open_kitti(k.write_odometry(root / "kitti"))
    out = root / layout
    for index, frame in enumerate(k.frames_of(log, [velo_to_world(f) for f in range(log.frames)], NUMBERS)):
        if layout == "kitti_format":
            write_kitti_format(out, index, frame)
        else:
            write_processed(out, index, frame, columns=int(layout.removeprefix("processed")))
    return log, open_waymo(out)


@pytest.mark.parametrize("layout", ["processed14", "processed10", "kitti_format"])
def test_a_kitti_log_survives_the_layout(layout: str, tmp_path: Path) -> None:
    """Cameras, rays and points, to 1e-4; images and times exactly."""
    before, after = written(layout, tmp_path)
    assert len(before.images) == len(after.images) and len(before.sweeps) == len(after.sweeps) == k.FRAMES
    by_key = {(image.number, image.frame): image for image in after.images}
    for image in before.images:
        found = by_key[NUMBERS[image.number], image.frame]
        np.testing.assert_allclose(found.camera.world_to_cam, image.camera.world_to_cam, atol=TOLERANCE)
        np.testing.assert_allclose(rays(found.camera), rays(image.camera), atol=TOLERANCE)
        assert found.time == image.time
        assert (np.asarray(Image.open(found.path)) == np.asarray(Image.open(image.path))).all()
    for one, other in zip(before.sweeps, after.sweeps):
        np.testing.assert_allclose(other.read().points, one.read().points, atol=TOLERANCE)
        if layout != "kitti_format":  # which has no place for the beams' origin
            np.testing.assert_allclose(other.read().origin, one.read().origin, atol=TOLERANCE)


def rays(camera: Camera) -> np.ndarray:
    """(H, W, 3) unit directions in the world."""
    x = (np.arange(camera.width) + 0.5 - camera.cx) / camera.fx
    y = (np.arange(camera.height) + 0.5 - camera.cy) / camera.fy
    grid = np.stack([*np.meshgrid(x, y), np.ones((camera.height, camera.width))], axis=-1)
    return grid / np.linalg.norm(grid, axis=-1, keepdims=True) @ camera.world_to_cam[:3, :3]


@pytest.mark.parametrize("columns", [14, 10])
def test_columns_are_inferred_also_where_both_divide(columns: int) -> None:
    """70 rows of 14 values are 98 rows of 10: the lasers decide."""
    rng = np.random.default_rng(0)
    rows = rng.uniform(1.5, 9.5, (980 // columns, columns)).astype(np.float32)
    rows[:, -1] = rng.integers(0, 5, len(rows))
    found = columns_of(rows.reshape(-1), Path("sweep.bin"))
    assert found.shape == rows.shape and (found == rows).all()


def test_columns_that_fit_no_layout_are_refused() -> None:
    for values in (np.zeros(0), np.zeros(33), np.full(140, 0.5), np.full(140, np.nan)):
        with pytest.raises(SceneError, match="fit neither"):
            columns_of(values.astype(np.float32), Path("sweep.bin"))


def frame(index: int, sizes: dict[int, tuple[int, int]], distortion: tuple[float, ...]) -> Frame:
    rng = np.random.default_rng(index)
    pose = np.eye(4)
    pose[:3, 3] = 2000.0 + index, 3000.0, 40.0
    cameras = []
    for number, (width, height) in sizes.items():
        world_to_cam = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]]) @ np.linalg.inv(pose)
        image = rng.integers(0, 256, (height, width, 3), dtype=np.uint8)
        sky = np.zeros((height, width), bool)
        sky[:4] = True
        moving = np.zeros((height, width), bool)
        moving[6:10, 10:14] = True
        camera = Camera(width, height, 20.0, 20.0, width / 2, height / 2, world_to_cam)
        cameras.append(FrameCamera(number, camera, image, distortion, sky, moving))
    points = pose[:3, 3] + rng.uniform((5, -3, -1), (30, 3, 1), (50, 3))
    return Frame(0.1 * index, pose, tuple(cameras), points)


SIZES = {0: (24, 16), 1: (24, 16), 3: (24, 10)}


def test_a_side_camera_of_another_height_masks_and_distortion(tmp_path: Path) -> None:
    for index in range(4):
        write_processed(tmp_path / "log", index, frame(index, SIZES, (-0.1, 0.02, 0.0, 0.0, 0.0)))
    log = open_waymo(tmp_path / "log")
    cfg = SceneConfig(name="log", reader="waymo", test_every=4, log_cameras=[0, 1, 3])
    scene = scene_of_log(log, cfg)
    assert {view.image.shape for view in scene.train} == {(8, 12, 3), (5, 12, 3)}
    assert all(image.distortion == (-0.1, 0.02, 0.0, 0.0, 0.0) for image in log.images)
    view = scene.test[0]
    assert view.name == "test/cam0_000003" and view.frame == 3
    assert view.sky is not None and view.sky[0].all() and not view.sky[3:].any()
    assert view.moving is not None and view.moving[4, 6] and view.moving.sum() <= 12  # undistorted: it may widen


BROKEN = {
    "no pose": ("ego_pose/002.txt", None, "expected a pose of frame 002, found no such file"),
    "pose with NaN": ("ego_pose/002.txt", b"nan " * 16, "002.txt: expected finite numbers, found NaN or Inf"),
    "no extrinsics": ("extrinsics/0.txt", None, "extrinsics/0.txt: expected a file, found none"),
    "short intrinsics": ("intrinsics/0.txt", b"20 20 12 8", "intrinsics/0.txt: expected 9 numbers"),
    "sweep cut short": ("lidar/002.bin", bytes(56), "fit neither: cut short, or of another layout"),
    "odd bytes": ("lidar/002.bin", bytes(57), "57 bytes: the file is cut short"),
    "times run back": ("timestamps.txt", b"0\n1\n0.5\n2\n", "they run back"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_damage_is_refused_in_one_line(name: str, tmp_path: Path) -> None:
    for index in range(4):
        write_processed(tmp_path / "log", index, frame(index, SIZES, (0.0,) * 5))
    file, content, message = BROKEN[name]
    if content is None:
        (tmp_path / "log" / file).unlink()
    else:
        # Bytes of zeros would be valid rows of zeros: an origin that is far away fits no layout.
        content = content if "lidar" not in file or len(content) % 4 else np.full(14, 99.5, "<f4").tobytes()
        (tmp_path / "log" / file).write_bytes(content)
    with pytest.raises(SceneError) as refused:
        scene_of_log(open_waymo(tmp_path / "log"), SceneConfig(name="log", reader="waymo", test_every=4))
    assert message in str(refused.value) and "\n" not in str(refused.value)


def test_a_mask_of_another_size_is_refused(tmp_path: Path) -> None:
    for index in range(4):
        write_processed(tmp_path, index, frame(index, SIZES, (0.0,) * 5))
    Image.new("L", (23, 16)).save(tmp_path / "sky_masks" / "001_0.png")
    with pytest.raises(SceneError, match=r"sky_masks/001_0.png: expected 24 x 16 pixels as its image, found 23 x 16"):
        scene_of_log(open_waymo(tmp_path), SceneConfig(name="log", reader="waymo", test_every=4))


def test_what_is_no_log_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="none of their folders"):
        open_waymo(tmp_path)
    (tmp_path / "file").write_text("")
    with pytest.raises(SceneError, match="a file"):
        open_source(SceneConfig("log", "waymo", str(tmp_path / "file")))
