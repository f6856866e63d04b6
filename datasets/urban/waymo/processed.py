"""Waymo, processed: a folder a scene, as EmerNeRF, DriveStudio and S3Gaussian read it.

    images/TTT_C.jpg        frame TTT, camera C: 0 front, 1 front left, 2 front right, 3 side left, 4 side right
    ego_pose/TTT.txt        4 x 4, vehicle -> world
    extrinsics/C.txt        4 x 4, camera -> vehicle, Waymo's camera axes: x forward, y left, z up
    intrinsics/C.txt        fx fy cx cy k1 k2 p1 p2 k3 at full resolution
    lidar/TTT.bin           rows of 14 or 10 float32, see columns_of
    sky_masks/TTT_C.png     > 0: sky (optional)
    dynamic_masks/TTT_C.png, or dynamic_masks/all/TTT_C.png     > 0: moves (optional)
    timestamps.txt          seconds, a line a frame (optional; without it 10 frames a second)
    truth/TTT_C.npz         ground truth of synthetic scenes (datasets/ground_truth.py)

Vehicle axes are x forward, y left, z up. Images of one camera are of one size; those of the sides may be less high.
"""

from __future__ import annotations

import re
from functools import partial
from pathlib import Path

import numpy as np

from datasets.files.errors import SceneError
from datasets.files.image_files import image_size
from datasets.scene import make_camera
from datasets.urban.log import DrivingLog, LogImage, SweepPoints, check_times, log_sweeps, numbered_files
from datasets.urban.number_files import (
    check_reach,
    numbers,
    read_floats,
    read_lines,
    read_matrix,
    read_rows,
    transformed,
)
from rasterizer.camera import Camera

# From OpenCV's camera axes (x right, y down, z forward) to Waymo's (x forward, y left, z up).
OPENCV_TO_WAYMO = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
RATE = 10.0  # frames a second
USUAL = (0, 1, 2)  # the frontal cameras, as the paper
SUFFIXES = (".jpg", ".jpeg", ".png")
# Columns of a sweep: beams' origin 0-2 and point 3-5, both in the vehicle's frame; the rest differs.
#   14: flow (3), flow class, ground, intensity, elongation, laser    10: ground, intensity, elongation, laser
COLUMNS = (14, 10)
LASERS = 5  # the last column is the number of the laser, 0 to 4
ORIGIN_WITHIN = 10.0  # metres: the beams start at the car


def open_processed(path: Path) -> DrivingLog:
    """The log of a processed scene. Raises SceneError for what is missing or does not fit."""
    poses = numbered_files(path / "ego_pose", (".txt",))
    if not poses:
        raise SceneError(path / "ego_pose", "files 000.txt, 001.txt, … of 4 x 4 numbers", "none")
    listed = _images(path / "images")
    frames = sorted({frame for frame, _ in listed})
    missing = [frame for frame in frames if frame not in poses]
    if missing:
        raise SceneError(path / "ego_pose", f"a pose of frame {missing[0]:03d}", "no such file")
    times = _times(path / "timestamps.txt", frames)
    vehicle_to_world = {frame: read_matrix(poses[frame]) for frame in frames}
    cameras = {number: _camera_file(path, number) for number in sorted({number for _, number in listed})}
    images = []
    for (frame, number), file in listed.items():
        parameters, camera_to_vehicle = cameras[number]
        width, height = image_size(file)
        pose = np.linalg.inv(vehicle_to_world[frame] @ camera_to_vehicle @ OPENCV_TO_WAYMO)
        fx, fy, cx, cy = parameters[:4].tolist()
        camera = make_camera(file, partial(Camera, width, height, fx, fy, cx, cy, pose))
        distortion = tuple(parameters[4:].tolist())
        stem = f"{frame:03d}_{number}"
        images.append(
            LogImage(
                frames.index(frame),
                number,
                times[frames.index(frame)],
                camera,
                file,
                distortion if any(distortion) else (),
                sky=_mask(path, ("sky_masks",), stem),
                moving=_mask(path, ("dynamic_masks/all", "dynamic_masks"), stem),
                truth=truth if (truth := path / "truth" / f"{stem}.npz").is_file() else None,
            )
        )
    sweeps = numbered_files(path / "lidar", (".bin",))
    found = log_sweeps(sweeps, frames, times, list(vehicle_to_world.values()), _read_sweep)
    return DrivingLog("Waymo, processed", path, tuple(images), found, USUAL)


def columns_of(values: np.ndarray, path: Path) -> np.ndarray:
    """(N, 14) or (N, 10) float32: the number of columns that divides the file and fits its content.

    It fits if the last column holds whole numbers of lasers, and the beams start at the car. SceneError otherwise.
    """
    for columns in COLUMNS:
        if values.size and values.size % columns == 0:
            rows = values.reshape(-1, columns)
            laser = rows[:, -1]
            whole = (laser == np.rint(laser)) & (laser >= 0) & (laser < LASERS)
            if whole.all() and (np.abs(rows[:, :3]) <= ORIGIN_WITHIN).all():
                return rows
    raise SceneError(
        path,
        f"rows of 14 or 10 float32 values (origin, point, …, number of the laser 0 to {LASERS - 1})",
        f"{values.size} values that fit neither: cut short, or of another layout",
    )


def _read_sweep(path: Path, vehicle_to_world: np.ndarray) -> SweepPoints:
    rows = columns_of(read_floats(path), path)
    check_reach(rows[:, 3:6], path)
    return SweepPoints(transformed(rows[:, 3:6], vehicle_to_world), transformed(rows[:, :3], vehicle_to_world))


def _images(folder: Path) -> dict[tuple[int, int], Path]:
    """(frame, camera) -> file, ascending."""
    found = {}
    for file in folder.iterdir() if folder.is_dir() else ():
        match = re.fullmatch(r"(\d{1,9})_(\d)", file.stem, re.ASCII)
        if match and file.suffix.lower() in SUFFIXES:
            found[int(match[1]), int(match[2])] = file
    if not found:
        raise SceneError(folder, "images 000_0.jpg, … (frame_camera)", "none")
    return dict(sorted(found.items()))


def _camera_file(path: Path, number: int) -> tuple[np.ndarray, np.ndarray]:
    """(intrinsics (9,), camera-to-vehicle (4, 4)) of a camera."""
    file = path / "intrinsics" / f"{number}.txt"
    words = [word for line in read_lines(file) for word in line.split()]
    parameters = numbers(words, file)
    if parameters.size != 9 or not (parameters[:2] > 0).all():
        raise SceneError(
            file, "9 numbers fx fy cx cy k1 k2 p1 p2 k3, fx and fy > 0", f"{parameters.size}: {parameters[:4].tolist()}"
        )
    return parameters, read_matrix(path / "extrinsics" / f"{number}.txt")


def _times(file: Path, frames: list[int]) -> list[float]:
    """Seconds of each frame."""
    if not file.is_file():
        return [frame / RATE for frame in frames]
    rows = read_rows(file, 1)[:, 0]
    if frames[-1] >= len(rows):
        raise SceneError(file, f"a line of frame {frames[-1]}", f"{len(rows)} lines")
    times = rows[frames].tolist()
    check_times(times, file)
    return times


def _mask(path: Path, folders: tuple[str, ...], stem: str) -> Path | None:
    for folder in folders:
        for suffix in (".png", ".jpg"):
            if (file := path / folder / f"{stem}{suffix}").is_file():
                return file
    return None
