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

import numpy as np

from datasets.files.atomic_write import atomic_folder, write_json
from datasets.files.errors import SceneError
from datasets.urban.waymo.components import (
    Calibration,
    Components,
    Row,
    camera_calibrations,
    camera_images,
    labelled_boxes,
    laser_calibrations,
    pixel_poses,
    range_images,
    the_segment,
    vehicle_poses,
)
from datasets.urban.waymo.labelled_boxes import moving_boxes
from datasets.urban.waymo.processed import OPENCV_TO_WAYMO
from datasets.urban.waymo.range_image import inclinations, points_of
from datasets.urban.write import Frame, FrameCamera, write_processed
from rasterizer.camera import Camera


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
    poses_of_pixels = _by_time(pixel_poses(files), times)
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
                points @ vehicle_to_first[:3, :3].T + vehicle_to_first[:3, 3],
                origins @ vehicle_to_first[:3, :3].T + vehicle_to_first[:3, 3],
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


if __name__ == "__main__":
    sys.exit(main())
