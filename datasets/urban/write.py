"""Writes a driving log in the layout of waymo/processed.py: synthetic drives, converted logs."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from PIL import Image

from datasets.urban.number_files import transformed
from datasets.urban.waymo.processed import OPENCV_TO_WAYMO
from rasterizer.camera import Camera


@dataclass(frozen=True)
class FrameCamera:
    """One camera at one frame."""

    number: int
    camera: Camera  # world_to_cam in the log's world
    image: np.ndarray | bytes  # (H, W, 3) uint8, written as PNG; or the bytes of a JPEG
    distortion: tuple[float, ...] = (0.0,) * 5  # k1 k2 p1 p2 k3
    sky: np.ndarray | None = None  # (H, W) bool
    moving: np.ndarray | None = None  # (H, W) bool
    truth: dict[str, np.ndarray] | None = None  # arrays of datasets/ground_truth.py


@dataclass(frozen=True)
class Frame:
    """Everything of one moment."""

    time: float  # seconds
    vehicle_to_world: np.ndarray  # (4, 4)
    cameras: tuple[FrameCamera, ...]
    points: np.ndarray | None = None  # (N, 3) world; None: no sweep
    origins: np.ndarray | None = None  # (3,) or (N, 3) world: where the beams start; None: the vehicle's origin
    lasers: np.ndarray | None = None  # (N,) number of the laser, 0 to 4; None: 0
    intensity: np.ndarray = field(default_factory=lambda: np.ones(1))  # (N,) or (1,)


def write_processed(folder: Path, index: int, frame: Frame, columns: int = 14) -> None:
    """Frame `index` in the processed layout. columns: of the sweep, 14 or 10."""
    stem = f"{index:03d}"
    _save(folder / "ego_pose" / f"{stem}.txt", frame.vehicle_to_world)
    _append_time(folder, frame.time, index)
    world_to_vehicle = np.linalg.inv(frame.vehicle_to_world)
    for one in frame.cameras:
        c = one.camera
        if index == 0 or not (folder / "intrinsics" / f"{one.number}.txt").is_file():
            camera_to_vehicle = world_to_vehicle @ np.linalg.inv(c.world_to_cam) @ np.linalg.inv(OPENCV_TO_WAYMO)
            _save(folder / "extrinsics" / f"{one.number}.txt", camera_to_vehicle)
            _save(folder / "intrinsics" / f"{one.number}.txt", np.array([c.fx, c.fy, c.cx, c.cy, *one.distortion]))
        name = f"{stem}_{one.number}"
        _save_image(folder / "images", name, one.image)
        _save_mask(folder / "sky_masks" / f"{name}.png", one.sky)
        _save_mask(folder / "dynamic_masks" / f"{name}.png", one.moving)
        _save_truth(folder / "truth" / f"{name}.npz", one.truth)
    if frame.points is not None:
        rows = np.zeros((len(frame.points), columns), "<f4")
        origins = frame.vehicle_to_world[:3, 3] if frame.origins is None else frame.origins
        rows[:, :3] = transformed(origins, world_to_vehicle)
        rows[:, 3:6] = transformed(frame.points, world_to_vehicle)
        rows[:, -3] = frame.intensity
        rows[:, -1] = 0 if frame.lasers is None else frame.lasers
        _made(folder / "lidar" / f"{stem}.bin").write_bytes(rows.tobytes())


def _made(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    return path


def _save(path: Path, values: np.ndarray) -> None:
    np.savetxt(_made(path), values, fmt="%.17g")


def _append_time(folder: Path, time: float, index: int) -> None:
    with open(_made(folder / "timestamps.txt"), "w" if index == 0 else "a") as file:
        file.write(f"{time:.17g}\n")


def _save_image(folder: Path, name: str, image: np.ndarray | bytes) -> None:
    if isinstance(image, bytes):
        _made(folder / f"{name}.jpg").write_bytes(image)
    else:
        Image.fromarray(image).save(_made(folder / f"{name}.png"), compress_level=1)


def _save_mask(path: Path, mask: np.ndarray | None) -> None:
    if mask is not None:
        Image.fromarray(mask * np.uint8(255)).save(_made(path))


def _save_truth(path: Path, arrays: dict[str, np.ndarray] | None) -> None:
    if arrays is not None:
        np.savez_compressed(_made(path), **arrays)  # type: ignore[arg-type]
