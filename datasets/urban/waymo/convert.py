"""python -m datasets.urban.waymo.convert SPLIT_DIR --out DIR [--segment NAME] [--cameras 0 1 2] [--frames N]

Converts a segment of the Waymo Open Dataset 2 (parquet) to the processed layout (processed.py): JPEGs as they
are, poses relative to the first frame, calibrations, the first return of all lasers, and masks of what moves from the
labelled boxes. SPLIT_DIR holds a folder a component: camera_image/SEGMENT.parquet, …. Needs pyarrow.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from datasets.cameras.transforms import read_pose
from datasets.files.atomic_write import atomic_folder, write_json
from datasets.files.errors import SceneError
from datasets.urban.waymo.processed import OPENCV_TO_WAYMO
from datasets.urban.waymo.range_image import inclinations, points_of
from datasets.urban.write import Frame, FrameCamera, write_processed
from rasterizer.camera import Camera

CAMERAS = ("FRONT", "FRONT_LEFT", "FRONT_RIGHT", "SIDE_LEFT", "SIDE_RIGHT")  # 1 … 5 in the files
LASERS = ("TOP", "FRONT", "SIDE_LEFT", "SIDE_RIGHT", "REAR")  # likewise
TIME = "key.frame_timestamp_micros"
MOVING_SPEED = 1.0  # metres a second, of a box
MARGIN = 0.1  # of an image's sides, around it

Row = dict[str, Any]
Calibration = tuple[np.ndarray, np.ndarray, tuple[int, int]]


@dataclass(frozen=True)
class Components:
    """The files of one segment."""

    folder: Path
    segment: str

    def rows(self, component: str, columns: list[str], optional: bool = False) -> Iterator[Row]:
        """The rows of a component with these columns. SceneError for a missing file or column."""
        from pyarrow import ArrowException
        from pyarrow.parquet import ParquetFile

        path = self.folder / component / f"{self.segment}.parquet"
        if not path.is_file():
            if optional:
                return
            raise SceneError(path, f"the component {component} of the segment", "no such file")
        try:
            with ParquetFile(path) as file:
                missing = [name for name in columns if name not in file.schema_arrow.names]
                if missing:
                    raise SceneError(path, f"a column {missing[0]}", "none")
                for batch in file.iter_batches(batch_size=8, columns=columns):
                    yield from batch.to_pylist()
        except (ArrowException, OSError) as error:
            raise SceneError(path, "a parquet file of the Waymo Open Dataset 2", str(error)) from None


def convert(folder: Path, segment: str, out: Path, cameras: list[int], frames: int | None = None) -> int:
    """Converts one segment into `out`, which must be absent or empty; returns the number of frames."""
    files = Components(folder, segment)
    poses = vehicle_poses(files)
    times = sorted(poses)[:frames]
    calibrations = camera_calibrations(files)
    lasers = {row["laser"]: row for row in laser_calibrations(files)}
    first_to_world = poses[times[0]]
    images = _by_time(_images(files), times)
    sweeps = _by_time(_sweeps(files), times)
    pixel_poses = _by_time(_pixel_poses(files), times)
    boxes = _by_time(_boxes(files), times)
    with atomic_folder(out, marker="meta.json") as temporary:
        for index, time in enumerate(times):
            vehicle_to_first = np.linalg.inv(first_to_world) @ poses[time]
            points, origins, numbers, intensity = _points(
                sweeps.get(time, []), lasers, pixel_poses.get(time, []), poses[time]
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


def vehicle_poses(files: Components) -> dict[int, np.ndarray]:
    """Vehicle-to-world (4, 4) by time in microseconds."""
    column = "[VehiclePoseComponent].world_from_vehicle.transform"
    where = f"{files.folder / 'vehicle_pose'}: {column}"
    found = {row[TIME]: _pose(row[column], where) for row in files.rows("vehicle_pose", [TIME, column])}
    if not found:
        raise SceneError(where, "a pose a frame", "none")
    return found


def camera_calibrations(files: Components) -> dict[int, Calibration]:
    """Camera -> (fx fy cx cy k1 k2 p1 p2 k3, camera-to-vehicle (4, 4), (width, height))."""
    prefix = "[CameraCalibrationComponent]."
    names = [f"{prefix}intrinsic.{n}" for n in ("f_u", "f_v", "c_u", "c_v", "k1", "k2", "p1", "p2", "k3")]
    transform, size = f"{prefix}extrinsic.transform", [f"{prefix}width", f"{prefix}height"]
    found = {}
    for row in files.rows("camera_calibration", ["key.camera_name", *names, transform, *size]):
        values = np.array([float(row[name]) for name in names])
        matrix = _pose(row[transform], f"{files.folder / 'camera_calibration'}: {transform}")
        found[_number(row["key.camera_name"], CAMERAS)] = values, matrix, (int(row[size[0]]), int(row[size[1]]))
    return found


def laser_calibrations(files: Components) -> Iterator[Row]:
    """{laser, extrinsic (4, 4), beams (values or None, low, high)} of each laser."""
    prefix = "[LiDARCalibrationComponent]."
    names = [f"{prefix}extrinsic.transform", *(f"{prefix}beam_inclination.{n}" for n in ("values", "min", "max"))]
    for row in files.rows("lidar_calibration", ["key.laser_name", *names]):
        values = row[names[1]]
        yield {
            "laser": _number(row["key.laser_name"], LASERS),
            "extrinsic": _pose(row[names[0]], f"{files.folder / 'lidar_calibration'}: {names[0]}"),
            "beams": (None if values is None else np.array(values), float(row[names[2]]), float(row[names[3]])),
        }


def _images(files: Components) -> Iterator[Row]:
    column = "[CameraImageComponent].image"
    for row in files.rows("camera_image", [TIME, "key.camera_name", column]):
        yield {"time": row[TIME], "camera": _number(row["key.camera_name"], CAMERAS), "jpeg": row[column]}


def _sweeps(files: Components) -> Iterator[Row]:
    values, shape = (f"[LiDARComponent].range_image_return1.{name}" for name in ("values", "shape"))
    for row in files.rows("lidar", [TIME, "key.laser_name", values, shape]):
        image = _image(row[values], row[shape], 4, files.folder / "lidar")
        yield {"time": row[TIME], "laser": _number(row["key.laser_name"], LASERS), "image": image}


def _pixel_poses(files: Components) -> Iterator[Row]:
    values, shape = (f"[LiDARPoseComponent].range_image_return1.{name}" for name in ("values", "shape"))
    for row in files.rows("lidar_pose", [TIME, "key.laser_name", values, shape], optional=True):
        image = _image(row[values], row[shape], 6, files.folder / "lidar_pose")
        yield {"time": row[TIME], "laser": _number(row["key.laser_name"], LASERS), "image": image}


def _boxes(files: Components) -> Iterator[Row]:
    prefix = "[LiDARBoxComponent]."
    names = [f"{prefix}box.{part}.{axis}" for part in ("center", "size") for axis in "xyz"]
    names += [f"{prefix}box.heading", *(f"{prefix}speed.{axis}" for axis in "xy")]
    for row in files.rows("lidar_box", [TIME, *names], optional=True):
        if all(row[name] is not None for name in names):
            yield {"time": row[TIME], "box": np.array([float(row[name]) for name in names])}


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


def _camera(
    row: Row,
    calibration: tuple[np.ndarray, np.ndarray, tuple[int, int]],
    vehicle_to_world: np.ndarray,
    boxes: list[Row],
) -> FrameCamera:
    values, camera_to_vehicle, (width, height) = calibration
    camera_to_world = vehicle_to_world @ camera_to_vehicle @ OPENCV_TO_WAYMO
    fx, fy, cx, cy = values[:4].tolist()
    camera = Camera(width, height, fx, fy, cx, cy, np.linalg.inv(camera_to_world))
    distortion = tuple(values[4:].tolist())
    moving = moving_boxes([one["box"] for one in boxes], camera, vehicle_to_world, distortion) if boxes else None
    return FrameCamera(row["camera"], camera, row["jpeg"], distortion, moving=moving)


def moving_boxes(
    boxes: list[np.ndarray], camera: Camera, vehicle_to_world: np.ndarray, distortion: tuple[float, ...]
) -> np.ndarray:
    """(H, W) bool: outlines of the boxes that move faster than MOVING_SPEED, in the distorted image.

    boxes: (9,) centre, size, heading in the vehicle's frame, velocity in x and y. distortion: k1, k2, p1, p2, k3.
    """
    import cv2

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
        world = vehicle @ vehicle_to_world[:3, :3].T + vehicle_to_world[:3, 3]
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


def _number(name: object, names: tuple[str, ...]) -> int:
    """Ours, from 0, of a camera or laser, which files give as a number from 1 or by name."""
    if isinstance(name, str) and name in names:
        return names.index(name)
    if isinstance(name, int) and 1 <= name <= len(names):
        return name - 1
    raise SceneError("key.camera_name or key.laser_name", f"1 to {len(names)} or one of {', '.join(names)}", repr(name))


def _pose(values: object, where: str) -> np.ndarray:
    array = np.array(values, dtype=np.float64)
    if array.size != 16:
        raise SceneError(where, "16 numbers", f"{array.size}")
    return read_pose(array.reshape(4, 4), where)


def _image(values: object, shape: object, channels: int, where: Path) -> np.ndarray:
    """(H, W, channels) float32."""
    array, sides = np.array(values, dtype=np.float32), np.array(shape, dtype=np.int64)
    if sides.shape != (3,) or sides[2] != channels or array.size != int(np.prod(sides)):
        raise SceneError(where, f"a range image (H, W, {channels})", f"{array.size} values of shape {sides.tolist()}")
    return array.reshape(sides)


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


def the_segment(split: Path) -> str:
    """The name of the only segment in `split`."""
    found = sorted(path.stem for path in (split / "vehicle_pose").glob("*.parquet"))
    if len(found) != 1:
        raise SceneError(split / "vehicle_pose", "one segment, or --segment NAME", f"{len(found)} segments")
    return found[0]


if __name__ == "__main__":
    sys.exit(main())
