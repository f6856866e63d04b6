"""The folder-of-images form of the layout, as the released program's converter leaves it behind.

    DIR/images/cam00_0000.png …   camera, frame number; frames of a camera follow each other without a gap
    DIR/transforms_train.json, transforms_test.json
        {"w", "h", "fl_x", "fl_y", "cx", "cy": pixels, or "camera_angle_x": radians (see datasets/cameras/intrinsics.py),
         "frames": [{"file_path": "images/cam00_0000", "time": …, "transform_matrix": 4×4 camera-to-world}, …]}

Poses have Blender's camera axes. Which cameras are held out is not taken from the
two files but from scene.test_cameras, as for videos. Times are in any unit: frames, seconds, since 1970.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from datasets.cameras.intrinsics import intrinsics_of, read_lens, read_pinhole
from datasets.cameras.lens import Undistortion
from datasets.cameras.transforms import find_image, load_transforms, read_pose
from datasets.composition import compose
from datasets.files.image_files import common_size, read_rgba
from datasets.files.json_values import get_key, read_number
from datasets.scene import SceneError
from rasterizer.camera import Camera

FRAME_NAME = re.compile(r"(?P<camera>\D*(?P<number>\d+))_(?P<frame>\d+)")  # cam00_0000
SPLITS = ("train", "test")
STILL_TOLERANCE = 1e-6  # world units; a camera's pose is repeated in each of its frames
LATEST = 1e19  # nanoseconds since 1970 are 2e18
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
        for path in self.paths[first : first + count]:
            rgba = read_rgba(path)
            yield rgba[..., :3] if (rgba[..., 3] == 255).all() else compose(rgba, self.background)


def read_entries(root: Path) -> dict[str, list[Entry]]:
    """Camera -> its entries in order of frames, of both files; cameras by name."""
    cameras: dict[str, list[Entry]] = {}
    for split in SPLITS:
        path = root / f"transforms_{split}.json"
        content, frames = load_transforms(path)
        for index, frame in enumerate(frames):
            where = f"{path}: frames[{index}]"
            file_path, image_path = find_image(frame, where, root)
            parts = FRAME_NAME.fullmatch(Path(file_path).name.removesuffix(image_path.suffix))
            if parts is None:
                raise SceneError(f"{where}: file_path", "a name like images/cam00_0000", file_path)
            entry = Entry(
                where,
                image_path,
                int(parts["frame"]),
                read_number(get_key(frame, "time", where), f"{where}: time", LATEST),
                read_pose(get_key(frame, "transform_matrix", where), f"{where}: transform_matrix"),
                intrinsics_of(content, frame),
                path,
            )
            cameras.setdefault(parts["camera"], []).append(entry)
    return {name: sorted(cameras[name], key=lambda entry: entry.frame) for name in sorted(cameras)}


def camera_number(name: str) -> int:
    """cam07 -> 7."""
    return int(re.search(r"\d+$", name)[0])


def sequences(
    cameras: dict[str, list[Entry]], keep: Collection[int], background: tuple[float, float, float]
) -> tuple[ImageSequence, ...]:
    """The cameras in use, their frames and times checked."""
    kept = {name: entries for name, entries in cameras.items() if camera_number(name) in keep}
    # Of times since 1970 only differences say which frame it is: each camera's rate is a little rounded.
    earliest = min((entries[0].time for entries in kept.values()), default=0.0)
    found = []
    for name, entries in kept.items():
        rate = _rate(entries)
        paths = tuple(entry.image_path for entry in entries)
        found.append(
            ImageSequence(
                name,
                camera_number(name),
                paths[0],
                common_size(paths),
                rate,
                len(entries),
                (entries[0].time - earliest) * rate,
                paths,
                background,
            )
        )
    return tuple(found)


def read_camera(entries: list[Entry], size: tuple[int, int]) -> tuple[Camera, Undistortion]:
    """The camera of one camera's full-size images (width, height), and its lens."""
    first = entries[0]
    for entry in entries:
        if np.abs(entry.cam_to_world - first.cam_to_world).max() > STILL_TOLERANCE:
            raise SceneError(
                f"{entry.where}: transform_matrix",
                f"the pose of {first.image_path.name}, for cameras do not move",
                "another",
            )
    camera = read_pinhole(first.intrinsics, size, first.cam_to_world, first.where, first.file)
    return camera, Undistortion.of(camera, *read_lens(first.intrinsics, first.where))


def _rate(entries: list[Entry]) -> float:
    """Frames in a unit of time: a camera's frames follow each other without a gap, at equal steps in time."""
    first, last = entries[0], entries[-1]
    for index, entry in enumerate(entries):
        if entry.frame != first.frame + index:
            raise SceneError(entry.where, f"frame {first.frame + index} of its camera next", f"{entry.frame}")
    if len(entries) == 1:
        return SINGLE_FRAME_RATE
    if not last.time > first.time:
        raise SceneError(
            f"{last.where}: time", f"a time after that of frame {first.frame}, {first.time:.13g}", f"{last.time:.13g}"
        )
    rate = (len(entries) - 1) / (last.time - first.time)
    for index, entry in enumerate(entries):
        if not abs((entry.time - first.time) * rate - index) <= 0.5:
            raise SceneError(
                f"{entry.where}: time",
                f"{first.time + index / rate:.13g}, at equal steps in time",
                f"{entry.time:.13g}",
            )
    return rate
