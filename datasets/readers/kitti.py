"""KITTI: raw drives, odometry sequences and tracking sequences (Geiger et al., IJRR 2013), found by their files.

    raw         DATE/calib_{cam_to_cam,velo_to_cam,imu_to_velo}.txt; path is DATE/DATE_drive_NNNN_sync, with
                image_00 … 03/data/N.png, velodyne_points/data/N.bin, oxts/data/N.txt, */timestamps.txt
    odometry    path is sequences/NN, with calib.txt, times.txt, image_0 … 3/N.png, velodyne/N.bin; ../../poses/NN.txt
    tracking    path is training/image_02/NNNN, beside calib/NNNN.txt, oxts/NNNN.txt, velodyne/NNNN/N.bin, image_03

Images are rectified: no distortion; those of DATE_drive_NNNN_extract are not, and are refused by their size. KITTI's
pixel centres lie at integers, the Camera's at integer + ½. Sky masks are read from sky_02/…, sky_2/… beside the images
where they exist.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import datetime
from functools import partial
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from datasets.files.errors import SceneError
from datasets.files.image_files import image_size
from datasets.scene import make_camera
from datasets.settings import SceneConfig
from datasets.source import Log, Source, data_folder
from datasets.urban.assemble import DriveSource
from datasets.urban.log import DrivingLog, LogImage, check_times, log_sweeps, numbered_files, require_frames
from datasets.urban.number_files import entry, read_calibration, read_lines, read_rows, read_sweep, rigid, rigid_entry
from rasterizer.camera import Camera

IMAGES = (".png", ".jpg", ".jpeg")
COLUMNS = 4  # of a sweep: x, y, z in the Velodyne's frame, reflectance
RATE = 10.0  # frames a second
USUAL = (2, 3)  # the colour cameras
CAMERAS = range(4)
EARTH_RADIUS = 6378137.0  # metres
LATITUDE, LONGITUDE, ALTITUDE, ROLL, PITCH, YAW = range(6)  # of the 30 values; degrees, metres, radians


@dataclass(frozen=True)
class Calibration:
    """Of one drive."""

    projection: dict[int, np.ndarray]  # camera -> P (3, 4): rectified coordinates of camera 0 -> pixels
    velo_to_rectified: np.ndarray  # (4, 4) Velodyne -> rectified coordinates of camera 0
    sizes: dict[int, tuple[int, int]] = field(default_factory=dict)  # camera -> (width, height) of its rectified images


def open_source(cfg: SceneConfig, threads: int, log: Log) -> Source:
    return DriveSource(cfg, open_kitti(data_folder(cfg)), log)


def open_kitti(path: Path) -> DrivingLog:
    """The log of a folder in one of the three layouts. SceneError names what is missing."""
    path = Path(os.path.abspath(path))  # its name and its parents' are needed, also of "."
    if (path / "velodyne_points").is_dir() or (path / "oxts" / "data").is_dir():
        return _open_raw(path)
    if (path / "calib.txt").is_file() or (path / "times.txt").is_file():
        return _open_odometry(path)
    if path.parent.name.startswith("image_") and (path.parent.parent / "calib").is_dir():
        return _open_tracking(path)
    raise SceneError(
        path,
        "a KITTI drive: DATE_drive_NNNN_sync (raw), sequences/NN (odometry) or training/image_02/NNNN (tracking)",
        "none of their files",
    )


def _open_odometry(path: Path) -> DrivingLog:
    file = path / "calib.txt"
    values = read_calibration(file)
    projections = _projections(values, "P{}", file)
    calibration = Calibration(projections, rigid_entry(values, ("Tr", "Tr_velo_to_cam"), 4, file))
    poses_file = path / "poses.txt"
    if not poses_file.is_file():
        poses_file = path.parent.parent / "poses" / f"{path.name}.txt"
    poses = read_rows(poses_file, 12).reshape(-1, 3, 4)
    times = read_rows(path / "times.txt", 1)[:, 0].tolist()
    images, sky, numbers = _images(calibration, lambda kind, n: path / f"{kind}_{n}", path)
    for what, count, where in (("poses", len(poses), poses_file), ("times", len(times), path / "times.txt")):
        if numbers[-1] >= count:
            raise SceneError(where, f"{what} of frame {numbers[-1]}", f"{count} {what}")
    rectified_to_world = [rigid(poses[n], f"{poses_file}: line {n + 1}") for n in numbers]
    own_times = [times[n] for n in numbers]
    check_times(own_times, path / "times.txt")
    sweeps = numbered_files(path / "velodyne", (".bin",))
    stamps = dict.fromkeys(images, own_times)
    return _log("KITTI odometry", path, calibration, numbers, stamps, rectified_to_world, images, sky, sweeps)


def _open_raw(path: Path) -> DrivingLog:
    folder = path.parent
    file = folder / "calib_cam_to_cam.txt"
    values = read_calibration(file)
    rectification = rigid_entry(values, ("R_rect_00",), 3, file)
    velo_to_camera = rectification @ _rigid_file(folder / "calib_velo_to_cam.txt")
    imu_to_rectified = velo_to_camera @ _rigid_file(folder / "calib_imu_to_velo.txt")
    projections = _projections(values, "P_rect_{:02d}", file)
    calibration = Calibration(projections, velo_to_camera, _rectified_sizes(values, file))
    images, sky, numbers = _images(calibration, lambda kind, n: path / f"{kind}_{n:02d}" / "data", path)
    oxts = numbered_files(path / "oxts" / "data", (".txt",))
    require_frames(path / "oxts" / "data", oxts, numbers)
    rows = np.concatenate([read_rows(oxts[n], 30)[:1] for n in numbers])
    imu_to_world = poses_of_oxts(rows, path / "oxts")
    rectified_to_world = [pose @ np.linalg.inv(imu_to_rectified) for pose in imu_to_world]
    stamps = {n: _timestamps(path / f"image_{n:02d}" / "timestamps.txt", numbers) for n in images if images[n]}
    start = min(times[0] for times in stamps.values())
    times = {n: [time - start for time in listed] for n, listed in stamps.items()}
    sweeps = numbered_files(path / "velodyne_points" / "data", (".bin",))
    return _log("KITTI raw", path, calibration, numbers, times, rectified_to_world, images, sky, sweeps)


def _open_tracking(path: Path) -> DrivingLog:
    root, sequence = path.parent.parent, path.name
    file = root / "calib" / f"{sequence}.txt"
    values = read_calibration(file)
    rectification = rigid_entry(values, ("R_rect", "R0_rect"), 3, file)
    velo_to_camera = rectification @ rigid_entry(values, ("Tr_velo_cam", "Tr_velo_to_cam"), 4, file)
    imu_to_rectified = velo_to_camera @ rigid_entry(values, ("Tr_imu_velo", "Tr_imu_to_velo"), 4, file)
    calibration = Calibration(_projections(values, "P{}", file), velo_to_camera)
    images, sky, numbers = _images(calibration, lambda kind, n: root / f"{kind}_{n:02d}" / sequence, path)
    oxts = root / "oxts" / f"{sequence}.txt"
    rows = read_rows(oxts, 30)
    if numbers[-1] >= len(rows):
        raise SceneError(oxts, f"a line of frame {numbers[-1]}", f"{len(rows)} lines")
    imu_to_world = poses_of_oxts(rows[numbers], oxts)
    rectified_to_world = [pose @ np.linalg.inv(imu_to_rectified) for pose in imu_to_world]
    times = dict.fromkeys(images, [n / RATE for n in numbers])
    sweeps = numbered_files(root / "velodyne" / sequence, (".bin",))
    return _log("KITTI tracking", path, calibration, numbers, times, rectified_to_world, images, sky, sweeps)


def _log(
    layout: str,
    source: Path,
    calibration: Calibration,
    numbers: list[int],
    times: dict[int, list[float]],  # of each camera that has images, one a frame
    rectified_to_world: list[np.ndarray],
    images: dict[int, dict[int, Path]],
    sky: dict[int, dict[int, Path]],
    sweeps: dict[int, Path],
) -> DrivingLog:
    found = []
    for camera, listed in images.items():
        for frame, number in enumerate(numbers):
            if number in listed:  # cameras may miss a frame
                path, mask = listed[number], sky[camera].get(number)
                posed = _camera(path, calibration, camera, rectified_to_world[frame], source)
                found.append(LogImage(frame, camera, times[camera][frame], posed, path, sky=mask))
    time_of = next(iter(times.values()))  # cameras and Velodyne are triggered together
    poses = [pose @ calibration.velo_to_rectified for pose in rectified_to_world]
    read = partial(read_sweep, columns=COLUMNS)
    return DrivingLog(layout, source, tuple(found), log_sweeps(sweeps, numbers, time_of, poses, read), USUAL)


def _camera(path: Path, calibration: Calibration, number: int, rectified_to_world: np.ndarray, source: Path) -> Camera:
    """Of an image whose projection is P = K [R | t], with R the identity because images are rectified: t = K⁻¹ P[:, 3].

    SceneError for an image that is not of the calibration's size.
    """
    (width, height), projection = image_size(path), calibration.projection[number]
    size = calibration.sizes.get(number, (width, height))
    if size != (width, height):
        raise SceneError(
            path,
            "{} x {} pixels, the calibration's S_rect, as the rectified images of …_sync have".format(*size),
            f"{width} x {height}",
        )
    matrix = projection[:, :3]
    if not (matrix[0, 0] > 0 and matrix[1, 1] > 0 and abs(matrix[2, 2] - 1) < 1e-6):
        raise SceneError(f"{source}: calibration of camera {number}", "focal lengths above 0", f"{matrix.tolist()}")
    offset = np.eye(4)
    offset[:3, 3] = np.linalg.solve(matrix, projection[:, 3])
    fx, fy, cx, cy = (float(x) for x in (matrix[0, 0], matrix[1, 1], matrix[0, 2] + 0.5, matrix[1, 2] + 0.5))
    pose = offset @ np.linalg.inv(rectified_to_world)
    return make_camera(path, lambda: Camera(width, height, fx, fy, cx, cy, pose))


def _projections(values: dict[str, np.ndarray], name: str, file: Path) -> dict[int, np.ndarray]:
    """The projections that the file has; cameras without one are not read."""
    found = {n: entry(values, (name.format(n),), (3, 4), file) for n in CAMERAS if name.format(n) in values}
    if not found:
        raise SceneError(file, f"projections {name.format(0)} to {name.format(3)}", "none")
    return found


def _rectified_sizes(values: dict[str, np.ndarray], file: Path) -> dict[int, tuple[int, int]]:
    """Camera -> (width, height) in pixels, of the cameras whose S_rect the file has."""
    found = {n: entry(values, (f"S_rect_{n:02d}",), (2,), file) for n in CAMERAS if f"S_rect_{n:02d}" in values}
    return {n: (round(width), round(height)) for n, (width, height) in found.items()}


def _rigid_file(file: Path) -> np.ndarray:
    """A file with the entries R and T."""
    values = read_calibration(file)
    matrix = np.column_stack([entry(values, ("R",), (3, 3), file), entry(values, ("T",), (3,), file)])
    return rigid(matrix, str(file))


def _images(
    calibration: Calibration, folder: Callable[[str, int], Path], path: Path
) -> tuple[dict[int, dict[int, Path]], dict[int, dict[int, Path]], list[int]]:
    """(camera -> its images by number, the same of sky masks, the numbers of all frames, ascending).

    folder: of "image" or "sky" and a camera.
    """
    images, sky = ({n: numbered_files(folder(k, n), IMAGES) for n in calibration.projection} for k in ("image", "sky"))
    numbers = sorted({number for listed in images.values() for number in listed})
    if not numbers:
        raise SceneError(path, "images of at least one calibrated camera", "none")
    return images, sky, numbers


def _timestamps(file: Path, numbers: list[int]) -> list[float]:
    """Seconds of the given lines."""
    lines, times = read_lines(file), []
    for number in numbers:
        if number >= len(lines):
            raise SceneError(file, f"a line of frame {number}", f"{len(lines)} lines")
        try:
            times.append(datetime.fromisoformat(lines[number][:26]).timestamp())
        except ValueError:
            raise SceneError(
                f"{file}: line {number + 1}", "a date as 2011-09-26 13:08:25.060776421", lines[number]
            ) from None
    check_times(times, file)
    return times


def poses_of_oxts(rows: np.ndarray, where: Path) -> list[np.ndarray]:
    """IMU-to-world (4, 4) for each row (30,); the world is the IMU's frame at the first row.

    x = s r lon, y = s r ln tan(π (90 + lat) / 360), s = cos(lat₀): the Mercator map is scaled to metres at the first
    row's latitude. R = Rz(yaw) Ry(pitch) Rx(roll).
    """
    latitude = rows[:, LATITUDE]
    if not (np.abs(latitude) < 89).all():
        raise SceneError(where, "latitudes below 89 degrees", f"{float(np.abs(latitude).max()):g}")
    scale = np.cos(np.radians(latitude[0])) * EARTH_RADIUS
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    poses[:, 0, 3] = scale * np.radians(rows[:, LONGITUDE])
    poses[:, 1, 3] = scale * np.log(np.tan(np.pi * (90 + latitude) / 360))
    poses[:, 2, 3] = rows[:, ALTITUDE]
    poses[:, :3, :3] = Rotation.from_euler("ZYX", rows[:, [YAW, PITCH, ROLL]]).as_matrix()
    return list(np.linalg.inv(poses[0]) @ poses)
