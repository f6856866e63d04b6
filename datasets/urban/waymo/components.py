"""The components of a segment of the Waymo Open Dataset 2: parquet files, one for each kind of data, as rows.

Cameras and lasers are numbered from 0 here, from 1 in the files. Needs pyarrow.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from datasets.cameras.transforms import read_pose
from datasets.files.errors import SceneError

CAMERAS = ("FRONT", "FRONT_LEFT", "FRONT_RIGHT", "SIDE_LEFT", "SIDE_RIGHT")  # 1 … 5 in the files
LASERS = ("TOP", "FRONT", "SIDE_LEFT", "SIDE_RIGHT", "REAR")  # likewise
TIME = "key.frame_timestamp_micros"

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


def the_segment(split: Path) -> str:
    """The name of the only segment in `split`."""
    found = sorted(path.stem for path in (split / "vehicle_pose").glob("*.parquet"))
    if len(found) != 1:
        raise SceneError(split / "vehicle_pose", "one segment, or --segment NAME", f"{len(found)} segments")
    return found[0]


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


def camera_images(files: Components) -> Iterator[Row]:
    """{time, camera, jpeg} of each image."""
    column = "[CameraImageComponent].image"
    for row in files.rows("camera_image", [TIME, "key.camera_name", column]):
        yield {"time": row[TIME], "camera": _number(row["key.camera_name"], CAMERAS), "jpeg": row[column]}


def range_images(files: Components, poses: bool = False) -> Iterator[Row]:
    """{time, laser, image (H, W, 4)} of each sweep, its first returns.

    poses: (H, W, 6) instead, the vehicle's pose while each pixel of a sweep was measured; may be absent.
    """
    folder, kind, channels = ("lidar_pose", "LiDARPose", 6) if poses else ("lidar", "LiDAR", 4)
    values, shape = (f"[{kind}Component].range_image_return1.{name}" for name in ("values", "shape"))
    for row in files.rows(folder, [TIME, "key.laser_name", values, shape], optional=poses):
        image = _image(row[values], row[shape], channels, files.folder / folder)
        yield {"time": row[TIME], "laser": _number(row["key.laser_name"], LASERS), "image": image}


def labelled_boxes(files: Components) -> Iterator[Row]:
    """{time, box} of each label (convert.moving_boxes); may be absent."""
    prefix = "[LiDARBoxComponent]."
    names = [f"{prefix}box.{part}.{axis}" for part in ("center", "size") for axis in "xyz"]
    names += [f"{prefix}box.heading", *(f"{prefix}speed.{axis}" for axis in "xy")]
    for row in files.rows("lidar_box", [TIME, *names], optional=True):
        if all(row[name] is not None for name in names):
            yield {"time": row[TIME], "box": np.array([float(row[name]) for name in names])}


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
