"""Transforms files (transforms_train.json, …): entries of images with poses and intrinsics, read and checked."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from datasets.cameras.intrinsics import merge_intrinsics
from datasets.files.errors import SceneError
from datasets.files.image_files import is_file
from datasets.files.json_values import get_key, read_number, read_object
from datasets.files.named_files import named_path
from rasterizer.camera import MAX_DISTANCE

# Bound of |RᵀR - I|: D-NeRF stores float32 (2e-7), files rounded to four decimals reach 1e-4.
RIGID_TOLERANCE = 1e-3
# Appended in this order to a file_path without suffix. D-NeRF's files omit .png.
SUFFIXES = (".png", ".jpg", ".jpeg", ".PNG", ".JPG", ".JPEG")


@dataclass(frozen=True)
class TransformsEntry:
    """One entry of `frames` in a transforms file."""

    file: Path  # the transforms file
    where: str  # "DIR/transforms_train.json: frames[0]", for messages
    file_path: str  # as the file has it, "./train/r_0"; Windows' backslashes are slashes
    image_path: Path  # the image it names
    time: float | None  # finite, the file's unit; None: the entry has no time
    cam_to_world: np.ndarray  # (4, 4) float64, rigid, Blender axes
    intrinsics: dict[str, Any]  # see intrinsics.py


def read_transforms(file: Path, root: Path) -> list[TransformsEntry]:
    """All entries of a transforms file, one at least. `root`: the folder that file_path is relative to."""
    content, entries = _load(file)
    return [_read_entry(entry, content, f"{file}: frames[{i}]", file, root) for i, entry in enumerate(entries)]


def _load(file: Path) -> tuple[dict, list]:
    """The content of a transforms file and its list `frames`."""
    content = read_object(file, "an object with camera_angle_x and frames", "a transforms file")
    if content.get("from_na"):
        raise SceneError(f"{file}: from_na", "poses with OpenGL's camera axes, as without this key", "true (NeuS2)")
    entries = get_key(content, "frames", file)
    if not isinstance(entries, list) or not entries:
        found = "an empty list" if entries == [] else type(entries).__name__
        raise SceneError(f"{file}: frames", "a list of at least one frame", found)
    return content, entries


def _read_entry(entry: Any, content: dict, where: str, file: Path, root: Path) -> TransformsEntry:
    file_path, image_path = _find_image(entry, where, root)
    time = read_time(entry, where)
    pose = read_pose(get_key(entry, "transform_matrix", where), f"{where}: transform_matrix")
    return TransformsEntry(file, where, file_path, image_path, time, pose, merge_intrinsics(content, entry, where))


def _find_image(entry: Any, where: str, root: Path) -> tuple[str, Path]:
    """The file_path of an entry, without Windows' backslashes, and the existing file that it names."""
    if not isinstance(entry, dict):
        raise SceneError(where, "an object", type(entry).__name__)
    file_path = get_key(entry, "file_path", where)
    if not isinstance(file_path, str) or not Path(file_path).name:
        raise SceneError(f"{where}: file_path", "a file name", repr(file_path))
    named = root / file_path
    suffixes = ("",) if named.suffix in SUFFIXES else ("", *SUFFIXES)
    for written in (file_path, file_path.replace("\\", "/")):
        for suffix in suffixes:
            if is_file(image_path := Path(f"{root / written}{suffix}")):
                return written, image_path
    for suffix in suffixes:
        if is_file(image_path := named_path(root, f"{written}{suffix}")):
            return written, image_path
    without = "" if len(suffixes) == 1 else f", nor with {', '.join(SUFFIXES[:-1])} or {SUFFIXES[-1]} after it"
    raise SceneError(named, f"an image, named by {where}", f"no such file{without}")


def read_time(entry: dict, where: str) -> float | None:
    """The time of an entry, None without one; SceneError unless it is finite."""
    time = read_number(entry["time"], f"{where}: time") if "time" in entry else None
    if time is not None and not math.isfinite(time):
        raise SceneError(f"{where}: time", "a finite time", f"{time}")
    return time


def read_pose(value: Any, where: str) -> np.ndarray:
    """A camera-to-world matrix (4, 4) float64 from nested lists; SceneError unless rigid and within MAX_DISTANCE."""
    try:
        pose = np.array(value)
        if pose.dtype.kind not in "fiuO":  # O: integers beyond int64; strings are refused
            raise TypeError
        pose = pose.astype(np.float64)
    except (TypeError, ValueError, OverflowError, RecursionError):
        raise SceneError(where, "4 x 4 numbers", "ragged rows or something not a number") from None
    if pose.shape != (4, 4):
        raise SceneError(where, "4 x 4 numbers", f"shape {pose.shape}")
    if not np.isfinite(pose).all():
        raise SceneError(where, "finite numbers", "NaN or Inf")
    rotation, position = pose[:3, :3], pose[:3, 3]
    error = float(np.abs(rotation.T @ rotation - np.eye(3)).max()) if np.abs(rotation).max() <= 2 else math.inf
    determinant = np.linalg.det(rotation) if error < math.inf else math.nan
    if not (error <= RIGID_TOLERANCE and determinant > 0 and np.abs(pose[3] - [0, 0, 0, 1]).max() <= RIGID_TOLERANCE):
        raise SceneError(
            where,
            "a rigid pose (a rotation, last row 0 0 0 1)",
            f"|RᵀR - I| up to {error:.2g}, det R {determinant:.3g}, last row {pose[3].tolist()}",
        )
    if np.abs(position).max() > MAX_DISTANCE:
        raise SceneError(where, f"a position within {MAX_DISTANCE:g} of the origin", f"{position.tolist()}")
    pose[3] = 0, 0, 0, 1
    return pose
