"""Transforms files: the JSON that lists a scene's images with their poses, in the D-NeRF layout and its relatives."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from datasets.files.errors import read_json
from datasets.files.json_values import get_key
from datasets.scene import SceneError
from rasterizer.camera import FARTHEST

# RᵀR may differ from I by this much: D-NeRF stores float32 (2e-7), files rounded to four decimals reach 1e-4.
RIGID_TOLERANCE = 1e-3
# Tried in this order after a name without its ending. D-NeRF leaves .png out.
ENDINGS = (".png", ".jpg", ".jpeg", ".PNG", ".JPG", ".JPEG")


def load_transforms(path: Path) -> tuple[dict, list]:
    """A transforms file's content, and the list of its frames: one at least."""
    try:
        content = read_json(path, SceneError)
    except FileNotFoundError:
        raise SceneError(path, "a file (D-NeRF layout)", "none") from None
    if not isinstance(content, dict):
        raise SceneError(path, "an object with camera_angle_x and frames", type(content).__name__)
    entries = get_key(content, "frames", path)
    if not isinstance(entries, list) or not entries:
        raise SceneError(
            f"{path}: frames",
            "a list of at least one frame",
            "an empty list" if entries == [] else type(entries).__name__,
        )
    return content, entries


def find_image(entry: Any, where: str, root: Path) -> tuple[str, Path]:
    """The file_path of an entry of `frames`, as it stands there, and the file it names."""
    if not isinstance(entry, dict):
        raise SceneError(where, "an object", type(entry).__name__)
    file_path = get_key(entry, "file_path", where)
    if not isinstance(file_path, str) or not Path(file_path).name:
        raise SceneError(f"{where}: file_path", "a file name", repr(file_path))
    named = root / file_path
    candidates = [named, *(named.with_name(named.name + ending) for ending in ENDINGS)]
    if named.suffix in ENDINGS:
        candidates = candidates[:1]
    for image_path in candidates:
        if _is_file(image_path):
            return file_path, image_path
    without = "" if len(candidates) == 1 else f", nor with {', '.join(ENDINGS[:-1])} or {ENDINGS[-1]} after it"
    raise SceneError(named, f"an image, named by {where}", f"no such file{without}")


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except OSError:  # a name that is too long, a folder that may not be entered
        return False


def read_pose(value: Any, where: str) -> np.ndarray:
    """(4, 4) float64, rigid."""
    try:
        pose = np.array(value)
        if pose.dtype.kind not in "fiuO":  # O: integers too large for numpy's; text is no number
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
    if np.abs(position).max() > FARTHEST:
        raise SceneError(where, f"a position within {FARTHEST:g} of the origin", f"{position.tolist()}")
    pose[3] = 0, 0, 0, 1
    return pose
