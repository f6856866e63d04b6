"""Reader of the Plenoptic Video layout, and of multi-camera videos without poses.

    DIR/cam00.mp4, cam01.mp4, …     synchronised videos, one per camera (videos.py)
    DIR/poses_bounds.npy            their poses (poses.py)

or the output of the released program's converter, DIR/images and DIR/transforms_*.json (images.py). If a folder has
both, the videos are read. Every frame is decoded once, into a store in the cache folder (decode.py).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from datasets.cameras.color import ColorCorrection
from datasets.cameras.lens import Undistortion
from datasets.canonical import canonical_space
from datasets.composition import chosen_downscale
from datasets.files.errors import SceneError
from datasets.plenoptic.decode import fingerprint
from datasets.plenoptic.footage import Footage, FootageOptions
from datasets.plenoptic.images import camera_number, held_out_cameras, image_sequences, read_camera, read_cameras
from datasets.plenoptic.poses import read_poses
from datasets.plenoptic.sync import common_frames, select_cameras
from datasets.plenoptic.unsynchronised import align, is_synchronised, offsets_of
from datasets.plenoptic.videos import Video, VideoFile, find_cameras, find_footage, probe
from datasets.scene import Box, Scene
from rasterizer.camera import Camera

__all__ = [
    "Footage",
    "PosedFootage",
    "FootageOptions",
    "Undistortion",
    "open_plenoptic",
    "read_footage",
    "read_plenoptic",
]

# Bytes hashed at the beginning and at the end of each file.
VIDEO_PART = 1 << 20
IMAGE_PART = 1 << 12  # there are thousands of images; a PNG ends with checksums of its pixels


@dataclass(frozen=True)
class PosedFootage:
    """Footage with camera poses; no frame is decoded yet."""

    footage: Footage
    cameras: Mapping[str, Camera]  # by name; of the full-size images
    undistortion: Mapping[str, Undistortion] | None = None  # by name; None: no distortion
    unit: float = 1.0  # world units per normalised unit
    init_box: Box | None = None  # None: a cube around the cameras
    colors: Mapping[str, ColorCorrection] | None = None  # by name, of the cameras whose colours are corrected

    def first_images(self) -> dict[str, np.ndarray]:
        """Name -> the first frame of each camera, undistorted, full size."""
        return self.footage.first_images(self.undistortion)

    def to_scene(self) -> Scene:
        """The scene; decodes the frames that are not in the store."""
        return self.footage.to_scene(self.cameras, self.undistortion, self.unit, self.init_box, self.colors)


def read_plenoptic(path: str | Path, **options: Any) -> Scene:
    """The scene in folder `path`, in either form of the layout; decodes the frames that are not in the store.

    options: the fields of FootageOptions. Raises SceneError for invalid data, before decoding where possible.
    """
    return open_plenoptic(path, **options).to_scene()


def open_plenoptic(path: str | Path, **options: Any) -> PosedFootage:
    """`read_plenoptic` without the decoding."""
    root, checked = Path(path), FootageOptions(**options)
    if not root.is_dir():
        raise SceneError(root, "a folder in the Plenoptic Video layout", "a file" if root.exists() else "nothing there")
    files, poses, transforms = find_cameras(root), root / "poses_bounds.npy", root / "transforms_train.json"
    if files and (poses.exists() or not transforms.exists()):
        # Given poses are of the pixels as stored.
        footage = _footage(root, files, _videos(root, files, checked, square=False), checked)
        found = read_poses(poses, [file.name for file in files], footage.names, footage.size)
        return PosedFootage(footage, found.cameras, unit=found.unit, init_box=found.init_box)
    if transforms.exists():
        return _open_images(root, checked)
    raise SceneError(root, "cam00.mp4 … and poses_bounds.npy, or images and transforms_train.json", "neither")


def read_footage(path: str | Path, **options: Any) -> Footage:
    """The videos in folder `path`, of any names, without poses. options: the fields of FootageOptions.

    Where no camera has the number 0, the default of `test_cameras`, that of the lowest number is held out.
    """
    root, checked = Path(path), FootageOptions(**options)
    files = find_footage(root)
    numbers = {file.number for file in files}
    if not all(file.name.endswith(str(file.number)) for file in files):
        places = ", ".join(f"{file.number} {file.name}" for file in files)
        checked.log(f"cameras are numbered by their place in the order of names: {places}")
    elif checked.test_cameras == (0,) and 0 not in numbers:
        first = min(numbers - set(checked.drop_cameras), default=0)
        checked = replace(checked, test_cameras=(first,))
        checked.log(f"no camera has the number 0: camera {first} is held out (scene.test_cameras)")
    videos = _videos(root, files, checked)
    return (_footage if checked.sync == "none" else _unsynchronised)(root, files, videos, checked)


def _videos(root: Path, files: Sequence[VideoFile], options: FootageOptions, square: bool = True) -> tuple[Video, ...]:
    """The videos of the cameras in use, with a line for what is done to their frames. square: see videos.probe."""
    keep = select_cameras([file.number for file in files], root, options.test_cameras, options.drop_cameras)
    videos = probe(files, keep, options.drop_cameras, square)
    for video in videos:
        for note in video.header.notes():
            options.log(f"{video.path.name}: {note}")
    return videos


def _unsynchronised(
    root: Path, files: Sequence[VideoFile], videos: tuple[Video, ...], options: FootageOptions
) -> Footage:
    """Footage of cameras that started at different times; as filmed where they turn out to be synchronised."""
    offsets = offsets_of(root, videos, options.sync, options.offsets, options.log)
    if offsets is None:
        return _footage(root, files, videos, options)
    if is_synchronised(videos, offsets):
        options.log("less than half a frame apart: taken as synchronised")
        return _footage(root, files, videos, options)
    streams = align(videos, offsets, options.first_frame, options.frames)
    if not options.downscale:
        options = replace(options, downscale=chosen_downscale(streams[0].size))
    chosen = repr([(stream.size, stream.indices) for stream in streams])
    content = f"{_content(files, videos)} {chosen}"
    return Footage(root, streams, streams[0].count, content, replace(options, first_frame=0))


def _footage(root: Path, files: Sequence[VideoFile], videos: tuple[Video, ...], options: FootageOptions) -> Footage:
    count = common_frames(videos, options.first_frame, options.frames, options.drop_cameras)
    if not options.downscale:
        options = replace(options, downscale=chosen_downscale(videos[0].size))
    return Footage(root, videos, count, _content(files, videos), options)


def _content(files: Sequence[VideoFile], videos: Sequence[Video]) -> str:
    """Hash of all files, and whether frames are converted: stores of earlier versions hold the pixels as stored."""
    converted = " converted" if any(video.converted for video in videos) else ""
    return fingerprint([file.path for file in files], VIDEO_PART) + converted


def _open_images(root: Path, options: FootageOptions) -> PosedFootage:
    entries = read_cameras(root)
    stated = held_out_cameras(entries)
    if tuple(options.test_cameras) == (0,) and stated not in ((), (0,)):
        options = replace(options, test_cameras=stated)
        options.log(f"held out: {', '.join(map(str, stated))}, the cameras of transforms_test.json")
    keep = select_cameras([camera_number(name) for name in entries], root, options.test_cameras, options.drop_cameras)
    sequences = image_sequences(entries, keep, options.background)
    count = common_frames(sequences, options.first_frame, options.frames, options.drop_cameras)
    files = [frame.image_path for frames in entries.values() for frame in frames]
    content = f"{fingerprint(files, IMAGE_PART)} over {options.background}"
    footage = Footage(root, sequences, count, content, options)
    posed = {name: read_camera(entries[name], footage.size) for name in footage.names}
    cameras = {name: camera for name, (camera, _) in posed.items()}
    undistortion = {name: lens for name, (_, lens) in posed.items()}
    train_cameras = [camera for name, camera in cameras.items() if name not in footage.held_out]
    # This form of the layout has no bounds: one normalised unit is one canonical unit.
    return PosedFootage(footage, cameras, undistortion, unit=canonical_space(train_cameras).unit)
