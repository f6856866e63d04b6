"""Waymo in KITTI's format, as Periodic Vibration Gaussian and the authors' later code read it.

    image_C/ID.png or .jpg  camera C, 0 to 4: front, front left, front right, side left, side right
    calib/ID.txt            P0 … P4 (3 x 4), R0_rect (3 x 3), Tr_velo_to_cam_0 … _4 (3 x 4, vehicle -> OpenCV's camera)
    pose/ID.txt             4 x 4, vehicle -> world
    velodyne/ID.bin         rows of 6 float32: x y z (vehicle's frame), intensity, elongation, unused
    sky_C/ID.png            > 0: sky (optional; also image_0C and sky_0C)
    timestamps.txt          seconds, a line a frame (optional; without it 10 frames a second)
    truth/ID_C.npz          ground truth of synthetic scenes (datasets/ground_truth.py)

ID is a number that grows with the frame. Images have no distortion parameters. A sweep's beams start somewhere on the
roof: ROOF stands for it.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np

from datasets.files.errors import SceneError
from datasets.files.image_files import image_size
from datasets.scene import make_camera
from datasets.urban.log import DrivingLog, LogImage, check_times, log_sweeps, numbered_files, require_frames
from datasets.urban.number_files import entry, read_calibration, read_matrix, read_rows, read_sweep, rigid_entry
from rasterizer.camera import Camera

CAMERAS = range(5)
USUAL = (0, 1, 2)
RATE = 10.0
COLUMNS = 6
SUFFIXES = (".png", ".jpg", ".jpeg")
ROOF = (1.43, 0.0, 2.18)  # metres in the vehicle's frame: Waymo's top LiDAR


def open_kitti_format(path: Path) -> DrivingLog:
    """The log of a scene in KITTI's format. Raises SceneError for what is missing or does not fit."""
    images = {n: _numbered(path, ("image_{}", "image_{:02d}"), n) for n in CAMERAS}
    sky = {n: _numbered(path, ("sky_{}", "sky_{:02d}"), n) for n in CAMERAS}
    numbers = sorted({number for listed in images.values() for number in listed})
    if not numbers:
        raise SceneError(path, "images in image_0, image_1, …", "none")
    calibrations, poses = (numbered_files(path / name, (".txt",)) for name in ("calib", "pose"))
    sweeps = numbered_files(path / "velodyne", (".bin",))
    for folder, files in (("calib", calibrations), ("pose", poses)):
        require_frames(path / folder, files, numbers)
    times = [frame / RATE for frame in range(len(numbers))]
    if (file := path / "timestamps.txt").is_file():
        times = read_rows(file, 1)[:, 0].tolist()
        if len(times) != len(numbers):
            raise SceneError(file, f"a line a frame, {len(numbers)}", f"{len(times)}")
        check_times(times, file)
    found = []
    vehicle_to_world = [read_matrix(poses[number]) for number in numbers]
    for frame, number in enumerate(numbers):
        values = read_calibration(calibrations[number])
        for camera_number, listed in images.items():
            if number not in listed:
                continue
            file = listed[number]
            camera = _camera(file, camera_number, values, vehicle_to_world[frame], calibrations[number])
            truth = path / "truth" / f"{file.stem}_{camera_number}.npz"
            mask = sky[camera_number].get(number)
            known = truth if truth.is_file() else None
            found.append(LogImage(frame, camera_number, times[frame], camera, file, sky=mask, truth=known))
    read = partial(read_sweep, columns=COLUMNS, start=ROOF)
    found_sweeps = log_sweeps(sweeps, numbers, times, vehicle_to_world, read)
    return DrivingLog("Waymo in KITTI's format", path, tuple(found), found_sweeps, USUAL)


def _camera(
    file: Path, number: int, values: dict[str, np.ndarray], vehicle_to_world: np.ndarray, where: Path
) -> Camera:
    projection = entry(values, (f"P{number}",), (3, 4), where)
    vehicle_to_camera = rigid_entry(values, (f"Tr_velo_to_cam_{number}",), 4, where)
    pose = vehicle_to_camera @ np.linalg.inv(vehicle_to_world)
    width, height = image_size(file)
    fx, fy, cx, cy = (float(projection[i]) for i in ((0, 0), (1, 1), (0, 2), (1, 2)))
    return make_camera(file, partial(Camera, width, height, fx, fy, cx, cy, pose))


def _numbered(path: Path, names: tuple[str, ...], number: int) -> dict[int, Path]:
    for name in names:
        if found := numbered_files(path / name.format(number), SUFFIXES):
            return found
    return {}
