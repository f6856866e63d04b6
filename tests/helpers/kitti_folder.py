"""Small driving logs in KITTI's layouts, with images and sweeps of noise, and their copy in other layouts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

from datasets.urban.log import DrivingLog
from datasets.urban.write import Frame, FrameCamera

WIDTH, HEIGHT, FOCAL = 24, 12, 20.0
BASELINE = 0.54  # metres between cameras 2 and 3
FRAMES = 5
POINTS = 60
# Velodyne (x forward, y left, z up) -> camera 0 (x right, y down, z forward), nearly.
VELO_TO_CAM = np.eye(4)
VELO_TO_CAM[:3, :3] = Rotation.from_euler("xyz", [0.01, -0.02, 0.015]).as_matrix() @ [[0, -1, 0], [0, 0, -1], [1, 0, 0]]
VELO_TO_CAM[:3, 3] = -0.01, -0.07, -0.27


def projections() -> dict[int, np.ndarray]:
    """P0 … P3 of a rectified rig."""
    found = {}
    for number, offset in enumerate((0.0, -BASELINE, 0.06, 0.06 - BASELINE)):
        found[number] = np.array([[FOCAL, 0, 11.3, FOCAL * offset], [0, FOCAL, 5.8, 0.01], [0, 0, 1, 0.002]])
    return found


def cam0_to_world(frame: int) -> np.ndarray:
    """Along z at a metre a frame, turning a little."""
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("y", 0.02 * frame).as_matrix()
    pose[:3, 3] = 0.05 * frame, -0.01 * frame, 1.0 * frame
    return pose


def sweep(frame: int, points: int = POINTS) -> np.ndarray:
    """(points, 4) float32 in front of the car."""
    rng = np.random.default_rng(frame)
    rows = rng.uniform((4, -2, -1, 0), (30, 2, 1, 1), (points, 4))
    return rows.astype("<f4")


def image(frame: int, camera: int) -> np.ndarray:
    return np.random.default_rng([frame, camera]).integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8)


def write_odometry(root: Path, frames: int = FRAMES) -> Path:
    """sequences/04 and poses/04.txt below `root`; returns the sequence's folder."""
    folder = root / "sequences" / "04"
    for number in (2, 3):
        _write_images(folder / f"image_{number}", number, frames, "{:06d}.png")
    _write_sweeps(folder / "velodyne", frames, "{:06d}.bin")
    lines = [f"P{n}: {_text(matrix)}" for n, matrix in projections().items()]
    (folder / "calib.txt").write_text("\n".join([*lines, f"Tr: {_text(VELO_TO_CAM[:3])}"]) + "\n")
    (folder / "times.txt").write_text("".join(f"{0.1037 * frame:.6e}\n" for frame in range(frames)))
    (root / "poses").mkdir()
    poses = "".join(_text(cam0_to_world(frame)[:3]) + "\n" for frame in range(frames))
    (root / "poses" / "04.txt").write_text(poses)
    return folder


OXTS_LATITUDE, OXTS_LONGITUDE = 49.0, 8.4
IMU_TO_VELO = np.eye(4)
IMU_TO_VELO[:3, 3] = -0.81, 0.32, -0.8
RECTIFICATION = Rotation.from_euler("xyz", [0.004, -0.007, 0.01]).as_matrix()


def oxts(frame: int) -> np.ndarray:
    """30 values: a metre north-east a frame, turning."""
    values = np.zeros(30)
    values[:6] = OXTS_LATITUDE + 6e-6 * frame, OXTS_LONGITUDE + 9e-6 * frame, 112.0, 0.01, 0.02 * frame, 0.8
    return values


def write_raw(root: Path, frames: int = FRAMES) -> Path:
    """2011_09_26/2011_09_26_drive_0001_sync below `root`; returns the drive's folder."""
    folder = root / "2011_09_26" / "2011_09_26_drive_0001_sync"
    for number in (2, 3):
        _write_images(folder / f"image_{number:02d}" / "data", number, frames, "{:010d}.png")
        _write_stamps(folder / f"image_{number:02d}" / "timestamps.txt", frames, 1e-4 * number)
    _write_sweeps(folder / "velodyne_points" / "data", frames, "{:010d}.bin")
    (folder / "oxts" / "data").mkdir(parents=True)
    for frame in range(frames):
        (folder / "oxts" / "data" / f"{frame:010d}.txt").write_text(_text(oxts(frame)) + "\n")
    lines = ["calib_time: 09-Jan-2012 13:57:47", f"R_rect_00: {_text(RECTIFICATION)}"]
    lines += [f"P_rect_{n:02d}: {_text(matrix)}" for n, matrix in projections().items()]
    (folder.parent / "calib_cam_to_cam.txt").write_text("\n".join(lines) + "\n")
    for name, matrix in (("velo_to_cam", VELO_TO_CAM), ("imu_to_velo", IMU_TO_VELO)):
        text = f"R: {_text(matrix[:3, :3])}\nT: {_text(matrix[:3, 3])}\n"
        (folder.parent / f"calib_{name}.txt").write_text(text)
    return folder


def write_tracking(root: Path, frames: int = FRAMES) -> Path:
    """training/… below `root`; returns training/image_02/0001."""
    training = root / "training"
    for number in (2, 3):
        _write_images(training / f"image_{number:02d}" / "0001", number, frames, "{:06d}.png")
    _write_sweeps(training / "velodyne" / "0001", frames, "{:06d}.bin")
    for name in ("calib", "oxts"):
        (training / name).mkdir()
    lines = [f"P{n}: {_text(matrix)}" for n, matrix in projections().items()]
    lines += [f"R_rect {_text(RECTIFICATION)}", f"Tr_velo_cam {_text(VELO_TO_CAM[:3])}"]
    lines += [f"Tr_imu_velo {_text(IMU_TO_VELO[:3])}"]
    (training / "calib" / "0001.txt").write_text("\n".join(lines) + "\n")
    (training / "oxts" / "0001.txt").write_text("".join(_text(oxts(frame)) + "\n" for frame in range(frames)))
    return training / "image_02" / "0001"


def frames_of(log: DrivingLog, vehicle_to_world: list[np.ndarray], numbers: dict[int, int]) -> list[Frame]:
    """The frames of a log, to be written in another layout. numbers: of its cameras there."""
    found = []
    for frame in range(log.frames):
        images = [one for one in log.images if one.frame == frame]
        read = next(one for one in log.sweeps if one.frame == frame).read()
        cameras = tuple(
            FrameCamera(numbers[one.number], one.camera, np.asarray(Image.open(one.path).convert("RGB")))
            for one in images
        )
        found.append(Frame(images[0].time, vehicle_to_world[frame], cameras, read.points, read.origin))
    return found


def _write_images(folder: Path, number: int, frames: int, name: str) -> None:
    folder.mkdir(parents=True)
    for frame in range(frames):
        Image.fromarray(image(frame, number)).save(folder / name.format(frame))


def _write_sweeps(folder: Path, frames: int, name: str) -> None:
    folder.mkdir(parents=True)
    for frame in range(frames):
        (folder / name.format(frame)).write_bytes(sweep(frame).tobytes())


def _write_stamps(file: Path, frames: int, offset: float) -> None:
    lines = [f"2011-09-26 13:08:{20 + 0.1 * frame + offset:012.9f}" for frame in range(frames)]
    file.write_text("\n".join(lines) + "\n")


def _text(values: np.ndarray) -> str:
    return " ".join(f"{value:.12e}" for value in np.ravel(values))
