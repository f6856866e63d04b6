"""TOML: a table for each camera, as anipose and aniposelib, caliscope and Pose2Sim write it.

    [cam_0]  name = "back", size = [w, h], matrix = 3×3, distortions = [k1, k2, p1, p2, …],
             rotation = Rodrigues' vector or 3×3, translation = [x, y, z], fisheye = false

Poses are world-to-camera in OpenCV's axes. caliscope's tables are `cameras.0` with `cam_id` instead of a name, and have
no matrix or `ignore = true` where a camera was not calibrated.
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from datasets.calibrations.rig import OPENCV_CENTRE, Rig, RigCamera, as_size, intrinsics_of, lens_of, pose_of
from datasets.files.errors import SceneError


def read(path: Path) -> Rig:
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except (OSError, ValueError) as error:  # TOMLDecodeError and UnicodeDecodeError are ValueErrors
        raise SceneError(path, "TOML", str(error)) from None
    nested = content.get("cameras")
    tables = {
        key: value for key, value in (nested if isinstance(nested, dict) else content).items() if _is_table(value)
    }
    posed = {
        key: table for key, table in tables.items() if not table.get("ignore") and {"matrix", "rotation"} <= set(table)
    }
    if not posed:
        raise SceneError(
            path, "a table for each camera with matrix, rotation and translation", ", ".join(content) or "none"
        )
    left = sorted(set(tables) - set(posed))
    notes = (f"{path.name}: {', '.join(left)} without matrix and pose, or to be ignored: left out",) if left else ()
    return Rig("TOML", tuple(_camera(key, table, f"{path}: {key}") for key, table in posed.items()), notes=notes)


def _is_table(value: Any) -> bool:
    return isinstance(value, dict) and bool({"matrix", "size", "cam_id"} & set(value))


def _camera(key: str, table: dict[str, Any], where: str) -> RigCamera:
    for needed in ("translation", "rotation", "matrix"):
        if needed not in table:
            raise SceneError(where, f"the key {needed}", f"only {', '.join(table)}")
    return RigCamera(
        str(table.get("name", table.get("cam_id", table.get("port", key)))),
        as_size(table["size"], f"{where}: size") if "size" in table else None,
        intrinsics_of(table["matrix"], OPENCV_CENTRE, f"{where}: matrix"),
        lens_of(table.get("distortions", []), f"{where}: distortions"),
        pose_of(table["rotation"], table["translation"], where),
        where,
        bool(table.get("fisheye", False)),
    )
