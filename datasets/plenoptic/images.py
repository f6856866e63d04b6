"""The folder-of-images form of the layout, as the released program's converter leaves it behind.

    DIR/images/cam00_0000.png …   camera, frame number; frames of a camera follow each other without a gap
    DIR/transforms_train.json, transforms_test.json
        {"w", "h", "fl_x", "fl_y", "cx", "cy": pixels (or "camera_angle_x": radians, and a centred principal point),
         "frames": [{"file_path": "images/cam00_0000", "time": …, "transform_matrix": 4×4 camera-to-world}, …]}

Keys are instant-ngp's, whose lens distortion ("k1", "k2", "p1", "p2", "k3") is understood too; intrinsics of a single
frame go before those of the file. Poses have Blender's camera axes. Which cameras are held out is not taken from the
two files but from scene.test_cameras, as for videos. Times are in any unit: frames, seconds, since 1970.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from datasets.dnerf import (common_size, compose, find_image, get_key, load_transforms, read_angle_x, read_number,
                            read_pose, read_rgba)
from datasets.plenoptic.decode import Undistortion
from datasets.scene import SceneError, camera_of
from rasterizer.camera import Camera

FRAME_NAME = re.compile(r"(?P<camera>\D*(?P<number>\d+))_(?P<frame>\d+)")  # cam00_0000
SPLITS = ("train", "test")
LENS_KEYS = ("k1", "k2", "p1", "p2", "k3")  # in OpenCV's order
LENS_MODELS = ("PINHOLE", "SIMPLE_PINHOLE", "OPENCV")
STILL_TOLERANCE = 1e-6  # world units; a camera's pose is repeated in each of its frames
LATEST = 1e19  # nanoseconds since 1970 are 2e18
LARGEST_LENS = 1e6  # of a coefficient; those of real lenses are below 100
SINGLE_FRAME_RATE = 30.0  # what the converter divides frame numbers by; from one frame no rate can be told


@dataclass(frozen=True)
class Entry:
    """One entry of a transforms file, checked."""

    where: str
    image_path: Path
    frame: int
    time: float  # the file's unit
    cam_to_world: np.ndarray  # (4, 4), Blender axes
    intrinsics: dict  # the keys of this frame and, where it has none, of the file
    file: Path


@dataclass(frozen=True)
class ImageSequence:
    """A camera's images: a decode.Stream."""

    name: str
    number: int
    path: Path  # of the first image
    size: tuple[int, int]  # (width, height)
    rate: float  # frames in a unit of the file's time
    count: int
    start: float  # when the first image was taken, in frames since the earliest camera's
    paths: tuple[Path, ...]
    background: tuple[float, float, float]  # under transparent pixels

    def read(self, first: int, count: int, threads: int) -> Iterator[np.ndarray]:
        """Images first … first + count - 1, each (height, width, 3) uint8 RGB; read by one thread."""
        for path in self.paths[first:first + count]:
            rgba = read_rgba(path)
            yield rgba[..., :3] if (rgba[..., 3] == 255).all() else compose(rgba, self.background)


def read_entries(root: Path) -> dict[str, list[Entry]]:
    """Camera -> its entries in order of frames, of both files; cameras by name."""
    cameras: dict[str, list[Entry]] = {}
    for split in SPLITS:
        path = root / f"transforms_{split}.json"
        content, frames = load_transforms(path)
        shared = {key: value for key, value in content.items() if key != "frames"}
        for index, frame in enumerate(frames):
            where = f"{path}: frames[{index}]"
            file_path, image_path = find_image(frame, where, root)
            parts = FRAME_NAME.fullmatch(Path(file_path).name.removesuffix(image_path.suffix))
            if parts is None:
                raise SceneError(f"{where}: file_path", "a name like images/cam00_0000", file_path)
            entry = Entry(where, image_path, int(parts["frame"]),
                          read_number(get_key(frame, "time", where), f"{where}: time", LATEST),
                          read_pose(get_key(frame, "transform_matrix", where), f"{where}: transform_matrix"),
                          {**shared, **frame}, path)
            cameras.setdefault(parts["camera"], []).append(entry)
    return {name: sorted(cameras[name], key=lambda entry: entry.frame) for name in sorted(cameras)}


def camera_number(name: str) -> int:
    """cam07 -> 7."""
    return int(re.search(r"\d+$", name)[0])


def sequences(cameras: dict[str, list[Entry]], keep: Collection[int], background: tuple[float, float, float]
              ) -> tuple[ImageSequence, ...]:
    """The cameras in use, their frames and times checked."""
    kept = {name: entries for name, entries in cameras.items() if camera_number(name) in keep}
    # Of times since 1970 only differences say which frame it is: each camera's rate is a little rounded.
    earliest = min((entries[0].time for entries in kept.values()), default=0.0)
    found = []
    for name, entries in kept.items():
        rate = _rate(entries)
        paths = tuple(entry.image_path for entry in entries)
        found.append(ImageSequence(name, camera_number(name), paths[0], common_size(paths), rate, len(entries),
                                   (entries[0].time - earliest) * rate, paths, background))
    return tuple(found)


def read_camera(entries: list[Entry], size: tuple[int, int]) -> tuple[Camera, Undistortion]:
    """The camera of one camera's full-size images (width, height), and its lens."""
    first = entries[0]
    for entry in entries:
        if np.abs(entry.cam_to_world - first.cam_to_world).max() > STILL_TOLERANCE:
            raise SceneError(f"{entry.where}: transform_matrix",
                             f"the pose of {first.image_path.name}, for cameras do not move", "another")
    values, where = first.intrinsics, first.where
    if "fl_x" in values:
        keys = ("fl_x", "fl_y", "cx", "cy")
        fx, fy, cx, cy = (read_number(get_key(values, key, where), f"{where}: {key}") for key in keys)
        # The file's size may be another scale of the same image than the files'.
        width, height = (read_number(values.get(key, pixels), f"{where}: {key}") for key, pixels in zip("wh", size))
        if not (width > 0 and height > 0
                and abs(width * size[1] / height - size[0]) <= max(1.0, size[1] / height) < math.inf):
            raise SceneError(where, "w x h of {} x {} or the same shape at another scale".format(*size),
                             f"{width:g} x {height:g}")
        fx, cx, fy, cy = fx * size[0] / width, cx * size[0] / width, fy * size[1] / height, cy * size[1] / height
    else:
        fx = fy = 0.5 * size[0] / math.tan(0.5 * read_angle_x(values, first.file))
        cx, cy = size[0] / 2, size[1] / 2
    if not (fx > 0 and fy > 0 and np.isfinite([fx, fy, cx, cy]).all()):
        raise SceneError(where, "finite intrinsics, fl_x and fl_y > 0", f"{fx:g}, {fy:g}, {cx:g}, {cy:g}")
    pose = camera_of(where, lambda: Camera.from_blender(*size, fx, first.cam_to_world).world_to_cam)
    camera = camera_of(where, lambda: Camera(*size, fx, fy, cx, cy, pose))
    return camera, Undistortion.of(camera, *_lens(values, where))


def _lens(values: dict, where: str) -> tuple[float, ...]:
    """Distortion coefficients, as LENS_KEYS; 0 where the file says nothing."""
    model = values.get("camera_model", LENS_MODELS[0])
    if model not in LENS_MODELS or values.get("is_fisheye"):
        raise SceneError(f"{where}: camera_model", ", ".join(LENS_MODELS), "a fisheye" if model in LENS_MODELS else
                         repr(model))
    return tuple(read_number(values.get(key, 0.0), f"{where}: {key}", LARGEST_LENS) for key in LENS_KEYS)


def _rate(entries: list[Entry]) -> float:
    """Frames in a unit of time: a camera's frames follow each other without a gap, at equal steps in time."""
    first, last = entries[0], entries[-1]
    for index, entry in enumerate(entries):
        if entry.frame != first.frame + index:
            raise SceneError(entry.where, f"frame {first.frame + index} of its camera next", f"{entry.frame}")
    if len(entries) == 1:
        return SINGLE_FRAME_RATE
    if not last.time > first.time:
        raise SceneError(f"{last.where}: time", f"a time after that of frame {first.frame}, {first.time:.13g}",
                         f"{last.time:.13g}")
    rate = (len(entries) - 1) / (last.time - first.time)
    for index, entry in enumerate(entries):
        if not abs((entry.time - first.time) * rate - index) <= 0.5:
            raise SceneError(f"{entry.where}: time", f"{first.time + index / rate:.13g}, at equal steps in time",
                             f"{entry.time:.13g}")
    return rate
