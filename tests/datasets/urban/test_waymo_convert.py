"""Range images against a loop over pixels; a segment of parquet files converted and read back."""

from __future__ import annotations

import io
from pathlib import Path

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from datasets.files.errors import SceneError
from datasets.readers.waymo import open_waymo
from datasets.urban.waymo.components import TIME
from datasets.urban.waymo.convert import convert, inclinations, main, moving_boxes, points_of
from datasets.urban.waymo.processed import OPENCV_TO_WAYMO
from rasterizer.camera import Camera

ROWS, COLUMNS = 5, 12
EXTRINSIC = np.eye(4)
EXTRINSIC[:3, :3] = Rotation.from_euler("z", 0.4).as_matrix()
EXTRINSIC[:3, 3] = 1.4, 0.0, 2.1
INTRINSICS = {
    "f_u": 20.0, "f_v": 20.5, "c_u": 12.0, "c_v": 8.0, "k1": 0.04, "k2": -0.3, "p1": 0.0, "p2": 0.0, "k3": 0.0
}  # fmt: skip
SEGMENT = "segment"
START = 1_550_000_000_000_000


def pose(frame: int) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_euler("z", 0.3 + 0.05 * frame).as_matrix()
    matrix[:3, 3] = 860.5 + frame, 1568.25, -65.0
    return matrix


def ranges(frame: int) -> np.ndarray:
    values = np.random.default_rng(frame).uniform(4, 40, (ROWS, COLUMNS)).astype(np.float32)
    values[1, 3] = -1.0  # no return
    return values


def naive_points(image: np.ndarray, beams: np.ndarray, poses: np.ndarray | None, frame_pose: np.ndarray) -> np.ndarray:
    """The data set's definition, pixel by pixel."""
    found = []
    correction = np.arctan2(EXTRINSIC[1, 0], EXTRINSIC[0, 0])
    for i in range(ROWS):
        for j in range(COLUMNS):
            r = float(image[i, j])
            if r <= 0:
                continue
            azimuth = (2 * (COLUMNS - j - 0.5) / COLUMNS - 1) * np.pi - correction
            up = beams[ROWS - 1 - i]  # beams are listed from the lowest
            local = r * np.array([np.cos(azimuth) * np.cos(up), np.sin(azimuth) * np.cos(up), np.sin(up)])
            point = EXTRINSIC @ [*local, 1]
            if poses is not None:
                roll, pitch, yaw, *shift = poses[i, j].astype(np.float64)
                of_pixel = np.eye(4)
                of_pixel[:3, :3] = Rotation.from_euler("xyz", [roll, pitch, yaw]).as_matrix()
                of_pixel[:3, 3] = shift
                point = np.linalg.inv(frame_pose) @ of_pixel @ point
            found.append(point[:3])
    return np.array(found)


@pytest.mark.parametrize("with_poses", [False, True])
def test_points_of_a_range_image(with_poses: bool) -> None:
    """Tolerance: both in float64, but ranges and poses of float32 are the same numbers."""
    image, lowest_first = ranges(0), np.linspace(-0.3, 0.05, ROWS)
    poses = None
    if with_poses:
        poses = np.random.default_rng(1).uniform(-0.02, 0.02, (ROWS, COLUMNS, 6)).astype(np.float32)
        poses[..., 3:] += pose(0)[:3, 3].astype(np.float32)
    found, origins, index = points_of(image, inclinations(lowest_first, 0, 0, ROWS), EXTRINSIC, poses, pose(0))
    np.testing.assert_allclose(found, naive_points(image, lowest_first, poses, pose(0)), atol=1e-9)
    assert len(index) == (image > 0).sum() and 1 * COLUMNS + 3 not in index
    reach = np.linalg.norm(found - origins, axis=1)
    np.testing.assert_allclose(reach, image.reshape(-1)[index], rtol=1e-9)


def test_evenly_spaced_beams_run_from_the_highest_down() -> None:
    found = inclinations(None, -0.2, 0.2, 4)
    np.testing.assert_allclose(found, [0.15, 0.05, -0.05, -0.15])


def write_segment(folder: Path, frames: int = 3) -> None:
    """The components that the converter reads, with the data set's names of columns; two cameras, one laser."""
    times = [START + 100_000 * frame for frame in range(frames)]

    def save(component: str, rows: list[dict]) -> None:
        (folder / component).mkdir(parents=True)
        pq.write_table(pa.Table.from_pylist(rows), folder / component / f"{SEGMENT}.parquet")

    save("vehicle_pose", [
        {TIME: t, "[VehiclePoseComponent].world_from_vehicle.transform": pose(f).ravel().tolist()}
        for f, t in enumerate(times)
    ])  # fmt: skip
    save("camera_image", [
        {TIME: t, "key.camera_name": n, "[CameraImageComponent].image": jpeg(f, n)} for f, t in enumerate(times)
        for n in (1, 2)
    ])  # fmt: skip
    save("camera_calibration", [
        {"key.camera_name": n, "[CameraCalibrationComponent].extrinsic.transform": EXTRINSIC.ravel().tolist(),
         "[CameraCalibrationComponent].width": 24, "[CameraCalibrationComponent].height": 16}
        | {f"[CameraCalibrationComponent].intrinsic.{key}": value for key, value in INTRINSICS.items()}
        for n in (1, 2)
    ])  # fmt: skip
    prefix = "[LiDARComponent].range_image_return1"
    save("lidar", [
        {TIME: t, "key.laser_name": 1, f"{prefix}.values": np.dstack([ranges(f)] * 4).ravel().tolist(),
         f"{prefix}.shape": [ROWS, COLUMNS, 4]} for f, t in enumerate(times)
    ])  # fmt: skip
    save("lidar_calibration", [
        {"key.laser_name": 1, "[LiDARCalibrationComponent].extrinsic.transform": EXTRINSIC.ravel().tolist(),
         "[LiDARCalibrationComponent].beam_inclination.values": None,
         "[LiDARCalibrationComponent].beam_inclination.min": -0.3,
         "[LiDARCalibrationComponent].beam_inclination.max": 0.05}
    ])  # fmt: skip
    box = {
        "center.x": 9.0,
        "center.y": 4.0,
        "center.z": 1.0,
        "size.x": 4.0,
        "size.y": 2.0,
        "size.z": 1.5,
        "heading": 0.4,
    }
    save("lidar_box", [
        {TIME: t, "[LiDARBoxComponent].speed.x": 5.0, "[LiDARBoxComponent].speed.y": 0.0}
        | {f"[LiDARBoxComponent].box.{key}": value for key, value in box.items()} for t in times
    ])  # fmt: skip


def jpeg(frame: int, number: int) -> bytes:
    file = io.BytesIO()
    Image.new("RGB", (24, 16), (40 * frame, 90, 50 * number)).save(file, "JPEG")
    return file.getvalue()


def test_a_segment_is_converted_and_read(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    """Poses relative to the first frame, times, calibrations, points and boxes are those of the files."""
    write_segment(tmp_path / "training")
    assert main([str(tmp_path / "training"), "--out", str(tmp_path / "out"), "--cameras", "0", "1"]) == 0
    assert f"scene=waymo scene.path={tmp_path / 'out'}" in capsys.readouterr().out
    log = open_waymo(tmp_path / "out")
    assert log.frames == 3 and {image.number for image in log.images} == {0, 1}
    beams = -0.3 + (np.arange(ROWS) + 0.5) / ROWS * 0.35
    for frame, sweep in enumerate(log.sweeps):
        vehicle_to_first = np.linalg.inv(pose(0)) @ pose(frame)
        expected = naive_points(ranges(frame), beams, None, pose(frame)) @ vehicle_to_first[:3, :3].T
        np.testing.assert_allclose(sweep.read().points, expected + vehicle_to_first[:3, 3], atol=1e-4)  # float32 files
        assert sweep.time == pytest.approx(0.1 * frame)
        image = next(one for one in log.images if (one.frame, one.number) == (frame, 1))
        world_to_cam = np.linalg.inv(vehicle_to_first @ EXTRINSIC @ OPENCV_TO_WAYMO)
        np.testing.assert_allclose(image.camera.world_to_cam, world_to_cam, atol=1e-6)
        assert image.distortion[:2] == (0.04, -0.3) and image.path.read_bytes() == jpeg(frame, 2)
        assert image.moving is not None and np.asarray(Image.open(image.moving)).any()


@pytest.mark.parametrize("distortion", [(0.0,) * 5, (0.04, -0.3, 0.0, 0.0, 0.0), (-0.2, 0.05, 0.002, -0.001, 0.0)])
def test_masks_of_boxes_are_those_of_the_distorted_image(distortion: tuple[float, ...]) -> None:
    """A pixel is in a mask if the ray that the lens sends there meets the box; the border may be off by two pixels."""
    camera = Camera(240, 160, 200.0, 205.0, 118.0, 82.0, np.linalg.inv(OPENCV_TO_WAYMO))
    boxes = [  # in the corner, across the border, far outside, at rest
        np.array([12.0, 5.5, 3.5, 4.0, 2.0, 1.5, 0.4, 5.0, 0.0]),
        np.array([8.0, -5.0, -0.5, 4.0, 4.0, 2.0, 0.9, 0.0, 3.0]),
        np.array([9.0, 20.0, -1.0, 4.0, 2.0, 1.5, 0.0, 5.0, 0.0]),
        np.array([9.0, 0.0, 0.0, 2.0, 2.0, 2.0, 0.0, 0.5, 0.0]),
    ]
    found = moving_boxes(boxes, camera, np.eye(4), distortion)
    columns, rows = np.meshgrid(np.arange(240) + 0.5, np.arange(160) + 0.5)
    bent = np.stack([(columns - camera.cx) / camera.fx, (rows - camera.cy) / camera.fy], axis=-1).reshape(-1, 2)
    straight, (k1, k2, p1, p2, _) = bent, distortion
    for _ in range(100):  # the inverse of OpenCV's model, by fixed-point iteration
        x, y, r2 = straight[:, 0], straight[:, 1], (straight**2).sum(axis=1)
        tangential = np.stack([2 * p1 * x * y + p2 * (r2 + 2 * x**2), p1 * (r2 + 2 * y**2) + 2 * p2 * x * y], axis=1)
        straight = straight + bent - straight * (1 + k1 * r2 + k2 * r2**2)[:, None] - tangential
    rays = np.insert(straight, 2, 1.0, axis=1) @ OPENCV_TO_WAYMO[:3, :3].T
    truth = np.zeros((160, 240), bool)
    for box in boxes[:2]:
        turned = Rotation.from_euler("z", -box[6]).as_matrix()
        start, along = turned @ -box[:3], rays @ turned.T
        ends = np.sort((np.array([[-0.5], [0.5]]) * box[3:6] - start)[:, None] / along, axis=0)
        truth |= (ends[0].max(axis=1) < ends[1].min(axis=1)).reshape(160, 240)
    assert truth[:, :60].any() and truth[:, -40:].any()
    kernel = np.ones((5, 5), np.uint8)
    widened, narrowed = (change(truth.astype(np.uint8), kernel) > 0 for change in (cv2.dilate, cv2.erode))
    assert not (found & ~widened).any() and not (narrowed & ~found).any()


def test_what_is_missing_is_named(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    write_segment(tmp_path / "training")
    (tmp_path / "training" / "lidar" / f"{SEGMENT}.parquet").unlink()
    with pytest.raises(SceneError, match=r"lidar/segment.parquet: expected the component lidar"):
        convert(tmp_path / "training", SEGMENT, tmp_path / "out", [0])
    path = tmp_path / "training" / "vehicle_pose" / f"{SEGMENT}.parquet"
    pq.write_table(pa.table({TIME: [1]}), path)
    with pytest.raises(SceneError, match=r"expected a column \[VehiclePoseComponent\].world_from_vehicle.transform"):
        convert(tmp_path / "training", SEGMENT, tmp_path / "out", [0])
    path.write_bytes(b"no parquet")
    with pytest.raises(SystemExit):
        main([str(tmp_path / "training"), "--out", str(tmp_path / "out")])
    assert "a parquet file of the Waymo Open Dataset 2" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
