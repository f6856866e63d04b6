"""KITTI's layouts: cameras and points against the data set's own formulas, and what is refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import kitti_folder as k
import numpy as np
import pytest
from PIL import Image

from datasets.files.errors import SceneError
from datasets.readers.kitti import open_kitti
from datasets.settings import SceneConfig
from datasets.source import open_source
from datasets.urban.log import DrivingLog, LogImage

LAYOUTS = {"odometry": k.write_odometry, "raw": k.write_raw, "tracking": k.write_tracking}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_points_project_as_the_data_set_says(layout: str, tmp_path: Path) -> None:
    """pixel = P_n · R_rect · Tr · X for each point of a sweep, whatever the poses. Pixel centres are integers there."""
    log = open_kitti(LAYOUTS[layout](tmp_path))
    rectification = np.eye(3) if layout == "odometry" else k.RECTIFICATION
    assert {image.number for image in log.images} == {2, 3} and log.frames == k.FRAMES
    for image in log.images:
        points = k.sweep(image.frame)[:, :3].astype(np.float64)
        in_cam0 = rectification @ (k.VELO_TO_CAM[:3, :3] @ points.T + k.VELO_TO_CAM[:3, 3:])
        x, y, z = k.projections()[image.number] @ np.vstack([in_cam0, np.ones(len(points))])
        np.testing.assert_allclose(projected(log, image), [x / z + 0.5, y / z + 0.5], atol=1e-6)  # of float64 matrices


def projected(log: DrivingLog, image: LogImage) -> np.ndarray:
    """(2, N) pixels of the points of the image's sweep."""
    world = next(sweep for sweep in log.sweeps if sweep.frame == image.frame).read().points
    c = image.camera
    x, y, z = c.world_to_cam[:3, :3] @ world.T + c.world_to_cam[:3, 3:]
    return np.stack([c.fx * x / z + c.cx, c.fy * y / z + c.cy])


def test_odometry_has_the_poses_and_times_of_its_files(tmp_path: Path) -> None:
    log = open_kitti(k.write_odometry(tmp_path))
    cam0_to_cam2 = np.linalg.inv(k.projections()[2][:, :3]) @ k.projections()[2][:, 3]
    for image in (image for image in log.images if image.number == 2):
        expected = np.linalg.inv(k.cam0_to_world(image.frame))
        expected[:3, 3] += cam0_to_cam2
        np.testing.assert_allclose(image.camera.world_to_cam, expected, atol=1e-9)
        assert image.time == pytest.approx(0.1037 * image.frame, abs=1e-6)


@pytest.mark.parametrize("layout", ["raw", "tracking"])
def test_oxts_poses_are_metres_in_the_first_imu_frame(layout: str, tmp_path: Path) -> None:
    """6e-6° of latitude are 0.668 m on a sphere of 6378137 m, 9e-6° of longitude at 49° 0.657 m; poses are theirs."""
    log = open_kitti(LAYOUTS[layout](tmp_path))
    origins = np.array([sweep.read().origin for sweep in log.sweeps])
    way = np.linalg.norm(np.diff(origins, axis=0), axis=1)
    east, north = np.radians([9e-6 * np.cos(np.radians(49)), 6e-6]) * 6378137.0
    np.testing.assert_allclose(way, np.hypot(east, north), rtol=0.05)  # the Velodyne also turns about the IMU


def test_cameras_of_a_raw_drive_have_their_own_times(tmp_path: Path) -> None:
    log = open_kitti(k.write_raw(tmp_path))
    times = {(image.number, image.frame): image.time for image in log.images}
    assert times[2, 0] == 0.0 and times[3, 0] == pytest.approx(1e-4, abs=1e-6)  # microseconds are read
    assert times[2, 3] == pytest.approx(0.3, abs=1e-6)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_path_may_be_relative(layout: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where it lacks the names of the folders that the layout is known by."""
    folder = LAYOUTS[layout](tmp_path)
    expected = [image.camera.world_to_cam for image in open_kitti(folder).images]
    name = folder.name
    for start, path in (
        (folder.parent, name),
        (folder, "."),
        (folder.parent, f"{name}/../{name}"),
        (folder, f"../{name}/."),
    ):
        monkeypatch.chdir(start)
        found = [image.camera.world_to_cam for image in open_kitti(Path(path)).images]
        np.testing.assert_array_equal(found, expected)


def test_images_that_are_not_rectified_are_refused(tmp_path: Path) -> None:
    """As in …_extract, where they have the size S and not S_rect; S_rect alone changes nothing."""
    folder = k.write_raw(tmp_path)
    calibration = folder.parent / "calib_cam_to_cam.txt"
    sizes = f"S_02: 2.8e+01 1.6e+01\nS_rect_02: {k.WIDTH:e} {k.HEIGHT:e}\n"
    calibration.write_text(calibration.read_text() + sizes)
    assert len(open_kitti(folder).images) == 2 * k.FRAMES
    extract = folder.rename(folder.with_name("2011_09_26_drive_0001_extract"))
    for path in (extract / "image_02" / "data").iterdir():
        Image.open(path).resize((28, 16)).save(path)
    with pytest.raises(SceneError, match=r"0\.png: expected 24 x 12 pixels, .* S_rect, .* found 28 x 16$") as refused:
        open_kitti(extract)
    assert "\n" not in str(refused.value)


def cut(path: Path, count: int = 5) -> None:
    path.write_bytes(path.read_bytes()[:-count])


def replaced(path: Path, old: str, new: str) -> None:
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new, 1))


Damage = Callable[[Path], None]
SEQUENCE = "sequences/04"
DAMAGES: dict[str, tuple[Damage, str]] = {
    "no calibration": (lambda root: (root / SEQUENCE / "calib.txt").unlink(), "calib.txt: expected a file, found none"),
    "no Tr": (lambda root: replaced(root / SEQUENCE / "calib.txt", "Tr:", "Tx:"), "calib.txt: Tr: expected 12 numbers"),
    "no poses": (lambda root: (root / "poses/04.txt").unlink(), "poses/04.txt: expected a file, found none"),
    "NaN pose": (
        lambda root: replaced(root / "poses/04.txt", "1.000000000000e+00", "nan"),
        "poses/04.txt: line 1: expected finite numbers, found NaN or Inf",
    ),
    "skewed pose": (
        lambda root: replaced(root / "poses/04.txt", "1.000000000000e+00", "1.5"),
        "poses/04.txt: line 1: expected a rigid pose",
    ),
    "short poses": (
        lambda root: (root / "poses/04.txt").write_text(" ".join(["1"] * 11)),
        "poses/04.txt: line 1: expected 12 numbers, found 11",
    ),
    "times run back": (
        lambda root: (root / SEQUENCE / "times.txt").write_text("0\n0.1\n0.05\n0.3\n0.4\n"),
        "times.txt: expected times that ascend, found 0.050000 s at frame 2, after 0.100000 s: they run back",
    ),
    "sweep cut short": (
        lambda root: cut(root / SEQUENCE / "velodyne/000001.bin"),
        "000001.bin: expected float32 values, four bytes each, found 955 bytes: the file is cut short",
    ),
    "sweep of three columns": (
        lambda root: cut(root / SEQUENCE / "velodyne/000001.bin", 4),
        "000001.bin: expected rows of 4 float32 values, found 239 values: the file is cut short",
    ),
    "sweep with NaN": (
        lambda root: (root / SEQUENCE / "velodyne/000001.bin").write_bytes(np.full((3, 4), np.nan, "<f4").tobytes()),
        "000001.bin: expected finite points, found NaN or Inf",
    ),
    "no images": (
        lambda root: [path.unlink() for path in (root / SEQUENCE).glob("image_*/*.png")] and None,
        "expected images of at least one calibrated camera, found none",
    ),
    "text for an image": (
        lambda root: (root / SEQUENCE / "image_2/000001.png").write_text("no image"),
        "000001.png: expected a readable image",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", DAMAGES)
def test_damage_is_refused_in_one_line(name: str, tmp_path: Path) -> None:
    folder = k.write_odometry(tmp_path)
    damage, message = DAMAGES[name]
    damage(tmp_path)
    with pytest.raises(SceneError) as refused:
        log = open_kitti(folder)
        for sweep in log.sweeps:
            sweep.read()
    assert message in str(refused.value) and "\n" not in str(refused.value)


def test_another_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=r"sequences/NN \(odometry\)"):
        open_kitti(tmp_path)
    with pytest.raises(SceneError, match="nothing there"):
        open_source(SceneConfig("log", "kitti", str(tmp_path / "absent")))


def test_a_camera_may_miss_a_frame(tmp_path: Path) -> None:
    folder = k.write_odometry(tmp_path)
    (folder / "image_3" / "000002.png").unlink()
    log = open_kitti(folder)
    assert log.frames == k.FRAMES and len(log.images) == 2 * k.FRAMES - 1
    assert Image.open(log.images[0].path).size == (k.WIDTH, k.HEIGHT)
