"""The image form of the Plenoptic Video layout, which the released program's converter writes.

    DIR/images/cam00_0000.png …   camera and frame number; the frame numbers of a camera have no gaps
    DIR/transforms_train.json, transforms_test.json
        {"w", "h", "fl_x", "fl_y", "cx", "cy": pixels, or "camera_angle_x": radians (see cameras/intrinsics.py),
         "frames": [{"file_path": "images/cam00_0000", "time": …, "transform_matrix": 4×4 camera-to-world}, …]}

Poses have Blender's camera axes. Times may be in any unit and from any origin. Held out are the cameras of
transforms_test.json, or those of scene.test_cameras.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from datasets.cameras.intrinsics import read_distortion, read_pinhole
from datasets.cameras.lens import Undistortion
from datasets.cameras.transforms import TransformsEntry, read_transforms
from datasets.composition import Color, compose
from datasets.files.errors import SceneError
from datasets.files.image_files import common_size, read_rgba
from datasets.plenoptic.decode import Stream
from datasets.plenoptic.sync import RATE_TOLERANCE, drop_advice, on_ticks, require_equal
from rasterizer.camera import Camera

FRAME_NAME = re.compile(r"(?P<camera>\D*(?P<number>\d+))_(?P<frame>\d+)")  # cam00_0000
SPLITS = ("train", "test")
STILL_TOLERANCE = 1e-6  # world units; the entries of a camera repeat its pose
LATEST = 1e19  # nanoseconds since 1970 are 2e18
START_TOLERANCE = 0.5  # frames
SINGLE_FRAME_RATE = 30.0  # the converter's frames per unit of time, which one frame alone does not determine


@dataclass(frozen=True)
class CameraFrame:
    """An entry of a transforms file with its frame number."""

    number: int
    time: float  # the file's unit
    entry: TransformsEntry


@dataclass(frozen=True)
class ImageSequence(Stream):
    """A camera's images."""

    paths: tuple[Path, ...]
    background: Color  # under transparent pixels

    def read(self, threads: int) -> Iterator[np.ndarray]:
        """Read by one thread."""
        for path in self.paths:
            rgba = read_rgba(path)
            yield rgba[..., :3] if (rgba[..., 3] == 255).all() else compose(rgba, self.background)


def read_cameras(root: Path) -> dict[str, list[CameraFrame]]:
    """Camera name, sorted -> its frames of both files, by frame number."""
    cameras: dict[str, list[CameraFrame]] = {}
    for split in SPLITS:
        for entry in read_transforms(root / f"transforms_{split}.json", root):
            parts = FRAME_NAME.fullmatch(Path(entry.file_path).name.removesuffix(entry.image_path.suffix))
            if parts is None:
                raise SceneError(f"{entry.where}: file_path", "a name like images/cam00_0000", entry.file_path)
            if entry.time is None or not abs(entry.time) <= LATEST:
                found = "none" if entry.time is None else f"{entry.time}"
                raise SceneError(f"{entry.where}: time", f"a number within ±{LATEST:g}", found)
            frame = CameraFrame(int(parts["frame"]), entry.time, entry)
            cameras.setdefault(parts["camera"], []).append(frame)
    return {name: sorted(cameras[name], key=lambda frame: frame.number) for name in sorted(cameras)}


def held_out_cameras(cameras: dict[str, list[CameraFrame]]) -> tuple[int, ...]:
    """The numbers of the cameras that transforms_test.json alone names."""
    files = {name: {frame.entry.file.name for frame in frames} for name, frames in cameras.items()}
    return tuple(camera_number(name) for name, of_one in files.items() if of_one == {"transforms_test.json"})


def camera_number(name: str) -> int:
    """cam07 -> 7."""
    digits = re.search(r"\d+$", name)
    assert digits is not None  # a camera's name in FRAME_NAME ends with its number
    return int(digits[0])


def image_sequences(
    cameras: dict[str, list[CameraFrame]], keep: Collection[int], background: Color
) -> tuple[ImageSequence, ...]:
    """The cameras with the numbers `keep`; SceneError if their frame numbers or times have gaps."""
    kept = {name: frames for name, frames in cameras.items() if camera_number(name) in keep}
    # Starts are relative to the earliest image: a rounded rate times the seconds since 1970 would be off by frames.
    earliest = min((frames[0].time for frames in kept.values()), default=0.0)
    sequences = []
    for name, frames in kept.items():
        rate = _frame_rate(frames)
        paths = tuple(frame.entry.image_path for frame in frames)
        sequences.append(
            ImageSequence(
                name=name,
                number=camera_number(name),
                path=paths[0],
                size=common_size(paths),
                rate=rate,
                ticks=tuple(range(len(frames))),
                times=tuple(frame.time - earliest for frame in frames),
                paths=paths,
                background=background,
            )
        )
    return tuple(sequences)


def in_use(
    sequences: Sequence[ImageSequence], first_frame: int, frames: int, drop: Collection[int]
) -> tuple[ImageSequence, ...]:
    """The images from `first_frame` on, at most `frames`, that every camera has.

    SceneError if sizes, rates or starts differ, or lengths where they matter. It names a camera that differs from the
    majority, and the setting that drops it.
    """
    cameras = [(s.path, drop_advice(s.number, drop)) for s in sequences]
    starts = [s.times[0] * s.rate for s in sequences]
    require_equal(cameras, " pixels", [s.size for s in sequences], "{0[0]} x {0[1]}".format)
    require_equal(cameras, " frames a second", [s.rate for s in sequences], "{:.6g}".format, RATE_TOLERANCE)
    require_equal(cameras, " frames", starts, "a first frame at {:g}".format, absolute=START_TOLERANCE)
    if any(s.count < first_frame + frames for s in sequences):
        require_equal(cameras, " frames", [s.count for s in sequences], str)
    shortest = min(s.count for s in sequences)
    if shortest <= first_frame:
        raise SceneError(
            f"{sequences[0].path.parent}: scene.first_frame",
            f"below the {shortest} frames of each camera",
            f"{first_frame}",
        )
    used = slice(first_frame, min(first_frame + frames, shortest))
    rate = sequences[0].rate
    return on_ticks(
        [replace(s, rate=rate, ticks=s.ticks[used], times=s.times[used], paths=s.paths[used]) for s in sequences],
        first_frame,
    )


def read_camera(frames: list[CameraFrame], size: tuple[int, int]) -> tuple[Camera, Undistortion]:
    """The camera of full-size images (width, height), and its lens. SceneError if the camera moves."""
    first = frames[0].entry
    for frame in frames:
        if np.abs(frame.entry.cam_to_world - first.cam_to_world).max() > STILL_TOLERANCE:
            raise SceneError(
                f"{frame.entry.where}: transform_matrix",
                f"the pose of {first.image_path.name}, for cameras do not move",
                "another",
            )
    camera = read_pinhole(first.intrinsics, size, first.cam_to_world, first.where, first.file)
    return camera, Undistortion.of(camera, *read_distortion(first.intrinsics, first.where))


def _frame_rate(frames: list[CameraFrame]) -> float:
    """Frames per unit of time. SceneError unless frame numbers are consecutive and times equidistant."""
    first, last = frames[0], frames[-1]
    for index, frame in enumerate(frames):
        if frame.number != first.number + index:
            raise SceneError(frame.entry.where, f"frame {first.number + index} of its camera next", f"{frame.number}")
    if len(frames) == 1:
        return SINGLE_FRAME_RATE
    if not last.time > first.time:
        raise SceneError(
            f"{last.entry.where}: time",
            f"a time after that of frame {first.number}, {first.time:.13g}",
            f"{last.time:.13g}",
        )
    rate = (len(frames) - 1) / (last.time - first.time)
    for index, frame in enumerate(frames):
        if not abs((frame.time - first.time) * rate - index) <= 0.5:
            raise SceneError(
                f"{frame.entry.where}: time",
                f"{first.time + index / rate:.13g}, at equal steps in time",
                f"{frame.time:.13g}",
            )
    return rate
