"""A scene without its pixels, in scene.json of a run folder: what a finished run needs when its data set has moved."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from datasets.files.errors import DataError, SceneError, read_json
from datasets.scene import Scene, View
from rasterizer.camera import Camera

FILE_NAME = "scene.json"
SCALARS = ("name", "duration", "time_start", "background", "extent", "init_box", "capture", "unit", "frame_rate",
           "playback_rate", "metre", "seconds_per_unit", "test_split")  # fmt: skip
INTRINSICS = ("width", "height", "fx", "fy", "cx", "cy")


class MissingImage:
    """Pixels (H, W, 3) uint8 of a data set that is not there."""

    dtype = np.dtype(np.uint8)

    def __init__(self, camera: Camera, data: Path) -> None:
        self.shape: tuple[int, ...] = (camera.height, camera.width, 3)
        self._data = data

    def __array__(self, dtype: np.dtype | None = None, copy: bool | None = None) -> np.ndarray:
        raise SceneError(self._data, "the data set of the run, for its images", "nothing there; --data names its place")


def to_dict(scene: Scene) -> dict[str, Any]:
    """The content of scene.json."""
    cameras: dict[int, int] = {}  # by id: the frames of a video share their camera
    rows: list[dict[str, Any]] = []

    def row_of(view: View) -> list[Any]:
        if id(view.camera) not in cameras:
            cameras[id(view.camera)] = len(rows)
            own = {name: getattr(view.camera, name) for name in INTRINSICS}
            rows.append({**own, "world_to_cam": view.camera.world_to_cam.tolist()})
        return [view.name, view.time, cameras[id(view.camera)], view.frame, view.filmed_by]

    views = {split: [row_of(view) for view in getattr(scene, split)] for split in ("train", "test")}
    return {**{name: getattr(scene, name) for name in SCALARS}, "cameras": rows, **views}


def read_scene(path: Path, data: Path) -> Scene:
    """The scene of a run's scene.json; data: where its data set was. DataError for another content."""
    content = read_json(path)
    try:
        cameras = [Camera(**{**row, "world_to_cam": np.array(row["world_to_cam"])}) for row in content["cameras"]]
        images = [MissingImage(camera, data) for camera in cameras]
        values: dict[str, Any] = {name: content[name] for name in SCALARS}
        for split in ("train", "test"):
            values[split] = tuple(
                View(cameras[index], time, images[index], name, frame=frame, filmed_by=filmed_by)
                for name, time, index, frame, filmed_by in content[split]
            )
        values["init_box"] = tuple(tuple(c) if isinstance(c, list) else c for c in values["init_box"])
        return Scene(**{**values, "background": tuple(values["background"])}, source=data)
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise DataError(path, "the scene of a run", f"something else ({error})") from None
