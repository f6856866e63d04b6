"""python -m datasets.urban.waymo.convert SPLIT_DIR --out DIR [--segment NAME] [--cameras 0 1 2] [--frames N]

Converts a segment of the Waymo Open Dataset 2 (parquet) to the processed layout (processed.py): JPEGs as they
are, poses relative to the first frame, calibrations, the first return of all lasers, and masks of what moves from the
labelled boxes. SPLIT_DIR holds a folder a component: camera_image/SEGMENT.parquet, …. Needs pyarrow.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from datasets.files.atomic_write import atomic_folder, write_json
from datasets.files.errors import SceneError
from datasets.urban.number_files import transformed
from datasets.urban.waymo.components import (
    Calibration,
    Components,
    Row,
    camera_calibrations,
    camera_images,
    labelled_boxes,
    laser_calibrations,
    range_images,
    the_segment,
    vehicle_poses,
)
from datasets.urban.waymo.processed import OPENCV_TO_WAYMO
from datasets.urban.write import Frame, FrameCamera, write_processed
from rasterizer.camera import Camera

MOVING_SPEED = 1.0  # metres a second, of a box
MARGIN = 0.1  # of an image's sides, around it


def convert(folder: Path, segment: str, out: Path, cameras: list[int], frames: int | None = None) -> int:
    """Converts one segment into `out`, which must be absent or empty; returns the number of frames."""
    files = Components(folder, segment)
    poses = vehicle_poses(files)
    times = sorted(poses)[:frames]
    calibrations = camera_calibrations(files)
    lasers = {row["laser"]: row for row in laser_calibrations(files)}
    first_to_world = poses[times[0]]
    images = _by_time(camera_images(files), times)
    sweeps = _by_time(range_images(files), times)
    poses_of_pixels = _by_time(range_images(files, poses=True), times)
    boxes = _by_time(labelled_boxes(files), times)
    with atomic_folder(out, marker="meta.json") as temporary:
        for index, time in enumerate(times):
            vehicle_to_first = np.linalg.inv(first_to_world) @ poses[time]
            points, origins, numbers, intensity = _points(
                sweeps.get(time, []), lasers, poses_of_pixels.get(time, []), poses[time]
            )
            written = tuple(
                _camera(row, calibrations[row["camera"]], vehicle_to_first, boxes.get(time, []))
                for row in images.get(time, [])
                if row["camera"] in cameras and row["camera"] in calibrations
            )
            frame = Frame(
                (time - times[0]) / 1e6,
                vehicle_to_first,
                written,
                transformed(points, vehicle_to_first),
                transformed(origins, vehicle_to_first),
                numbers,
                intensity,
            )
            write_processed(temporary, index, frame)
        write_json(temporary / "meta.json", {"segment": segment, "first_frame_to_world": first_to_world.tolist()})
    return len(times)


def _by_time(rows: Iterator[Row], times: list[int]) -> dict[int, list[Row]]:
    found: dict[int, list[Row]] = {time: [] for time in times}
    for row in rows:
        if row["time"] in found:
            found[row["time"]].append(row)
    return found


def _points(
    sweeps: list[Row], lasers: dict[int, Row], pixel_poses: list[Row], vehicle_to_world: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """(points, origins, laser, intensity) of one frame in the vehicle's frame."""
    poses = {row["laser"]: row["image"] for row in pixel_poses}
    parts = [(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), np.zeros(0))]
    for row in sweeps:
        calibration, image = lasers[row["laser"]], row["image"]
        values, low, high = calibration["beams"]
        beams = inclinations(values, low, high, len(image))
        points, origins, index = points_of(
            image[..., 0], beams, calibration["extrinsic"], poses.get(row["laser"]), vehicle_to_world
        )
        parts.append((points, origins, np.full(len(index), row["laser"]), image[..., 1].reshape(-1)[index]))
    points, origins, numbers, intensity = (np.concatenate(arrays) for arrays in zip(*parts))
    return points, origins, numbers, intensity


def _camera(row: Row, calibration: Calibration, vehicle_to_world: np.ndarray, boxes: list[Row]) -> FrameCamera:
    values, camera_to_vehicle, (width, height) = calibration
    camera_to_world = vehicle_to_world @ camera_to_vehicle @ OPENCV_TO_WAYMO
    fx, fy, cx, cy = values[:4].tolist()
    camera = Camera(width, height, fx, fy, cx, cy, np.linalg.inv(camera_to_world))
    distortion = tuple(values[4:].tolist())
    moving = moving_boxes([one["box"] for one in boxes], camera, vehicle_to_world, distortion) if boxes else None
    return FrameCamera(row["camera"], camera, row["jpeg"], distortion, moving=moving)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m datasets.urban.waymo.convert",
        description="Converts a segment of the Waymo Open Dataset 2 to the folder that scene=waymo reads.",
    )
    parser.add_argument("split", type=Path, help="folder of the components: camera_image/, lidar/, …")
    parser.add_argument("--out", type=Path, required=True, help="folder to make; must not exist or be empty")
    parser.add_argument("--segment", help="name of the parquet files; needed if there are several")
    parser.add_argument("--cameras", type=int, nargs="+", default=[0, 1, 2], help="default: the three frontal ones")
    parser.add_argument("--frames", type=int, help="the first so many frames (default: all)")
    options = parser.parse_args(arguments)
    if options.out.exists() and (not options.out.is_dir() or any(options.out.iterdir())):
        parser.error(f"--out {options.out}: expected a folder that does not exist or is empty")
    try:
        import pyarrow  # noqa: F401
    except ImportError:
        parser.error("pyarrow: expected it to be installed, found nothing; pip install pyarrow")
    try:
        segment = options.segment or the_segment(options.split)
        count = convert(options.split, segment, options.out, options.cameras, options.frames)
    except (SceneError, OSError) as error:
        parser.error(str(error))
    print(f"{options.out}: {count} frames; python -m pipeline scene=waymo scene.path={options.out}")
    return 0


def moving_boxes(
    boxes: list[np.ndarray], camera: Camera, vehicle_to_world: np.ndarray, distortion: tuple[float, ...]
) -> np.ndarray:
    """(H, W) bool: outlines of the boxes that move faster than MOVING_SPEED, in the distorted image.

    boxes: (9,) centre, size, heading in the vehicle's frame, velocity in x and y. distortion: k1, k2, p1, p2, k3.
    """
    matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    # Far outside the image the distortion's polynomial may lead back into it: hulls are cut off before.
    sides = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * (1 + 2 * MARGIN) - MARGIN
    shown = (sides * (camera.width, camera.height) - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
    mask = np.zeros((camera.height, camera.width), np.uint8)
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    for box in boxes:
        if np.hypot(*box[7:9]) <= MOVING_SPEED:
            continue
        c, s = np.cos(box[6]), np.sin(box[6])
        vehicle = (corners * box[3:6]) @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]).T + box[:3]
        world = transformed(vehicle, vehicle_to_world)
        x, y, z = camera.world_to_cam[:3, :3] @ world.T + camera.world_to_cam[:3, 3:]
        if (z > 0.1).all():
            hull = cv2.convexHull(np.stack([x / z, y / z], axis=1).astype(np.float32))
            area, seen = cv2.intersectConvexConvex(hull, shown.astype(np.float32))
            if area > 0:
                ends = seen.reshape(-1, 2).astype(np.float64)
                points = ends[:, None] + np.linspace(0, 1, 8)[:, None] * (np.roll(ends, -1, axis=0) - ends)[:, None]
                rays = np.insert(points.reshape(-1, 2), 2, 1.0, axis=1)  # edges are bent
                pixels, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), matrix, np.array(distortion))
                cv2.fillPoly(mask, [pixels.round().astype(np.int32)], 1)
    return mask > 0


def inclinations(values: np.ndarray | None, low: float, high: float, rows: int) -> np.ndarray:
    """(rows,) radians, from the first row, the highest, down: the given beams, or evenly spaced ones."""
    beams = low + (np.arange(rows) + 0.5) / rows * (high - low) if values is None or not len(values) else values
    return np.asarray(beams, dtype=np.float64)[::-1]


def points_of(
    ranges: np.ndarray,
    beams: np.ndarray,
    laser_to_vehicle: np.ndarray,
    pixel_poses: np.ndarray | None = None,
    vehicle_to_world: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(points (N, 3), beams' origins (N, 3), index (N,) of the pixel) in the vehicle's frame; of ranges (H, W) > 0.

    Column j of W looks to azimuth (2 (W - j - ½) / W - 1) π - atan2(E₁₀, E₀₀) with E = laser_to_vehicle: the last
    column to the left of straight behind. beams: (H,) by `inclinations`. pixel_poses: (H, W, 6) roll, pitch, yaw, x, y,
    z of the vehicle in the world while the pixel was measured, with vehicle_to_world (4, 4) of the frame; None: the
    vehicle's frame is that of the pixel.
    """
    height, width = ranges.shape
    correction = np.arctan2(laser_to_vehicle[1, 0], laser_to_vehicle[0, 0])
    azimuth = (2 * (width - np.arange(width) - 0.5) / width - 1) * np.pi - correction
    index = np.flatnonzero(ranges > 0)
    row, column = np.divmod(index, width)
    up, around, distance = beams[row], azimuth[column], ranges.reshape(-1)[index].astype(np.float64)
    local = distance[:, None] * np.stack([np.cos(around) * np.cos(up), np.sin(around) * np.cos(up), np.sin(up)], axis=1)
    points = transformed(local, laser_to_vehicle)
    origins = np.tile(laser_to_vehicle[:3, 3], (len(points), 1))
    if pixel_poses is None or vehicle_to_world is None:
        return points, origins, index
    poses = pixel_poses.reshape(-1, 6)[index].astype(np.float64)
    turns = Rotation.from_euler("ZYX", poses[:, [2, 1, 0]])
    world_to_vehicle = np.linalg.inv(vehicle_to_world)

    def in_frame(of_pixel: np.ndarray) -> np.ndarray:
        return transformed(turns.apply(of_pixel) + poses[:, 3:], world_to_vehicle)

    return in_frame(points), in_frame(origins), index


if __name__ == "__main__":
    sys.exit(main())
