"""Reads the Plenoptic Video layout, and bare videos that lack poses.

    DIR/cam00.mp4, cam01.mp4, …     synchronised videos, one a camera
    DIR/poses_bounds.npy            their poses (poses.py)

or what the released program's converter makes of them, DIR/images and DIR/transforms_*.json (images.py). Where a
folder holds both, the videos are read. Every frame is decoded once, into a store under the cache (decode.py).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from datasets.cameras.lens import Undistortion
from datasets.canonical import canonical_space
from datasets.plenoptic.decode import fingerprint
from datasets.plenoptic.footage import Footage, Reading
from datasets.plenoptic.images import camera_number, read_camera, read_entries, sequences
from datasets.plenoptic.poses import read_poses
from datasets.plenoptic.sync import choose, common_frames
from datasets.plenoptic.videos import VideoFile, find_cameras, find_footage, probe
from datasets.scene import Box, Scene, SceneError
from rasterizer.camera import Camera

__all__ = ["Footage", "Posed", "Reading", "Undistortion", "open_plenoptic", "read_footage", "read_plenoptic"]

VIDEO_PART = 1 << 20  # bytes at a video's beginning and at its end that tell whether it is the same
IMAGE_PART = 1 << 12  # there are thousands of images; a PNG ends in checksums of its pixels


@dataclass(frozen=True)
class Posed:
    """Footage and where its cameras stood: all there is to know before a frame is decoded."""

    footage: Footage
    cameras: Mapping[str, Camera]  # of the full-size images
    undistortion: Mapping[str, Undistortion] | None = None
    unit: float = 1.0
    init_box: Box | None = None

    def first_images(self) -> dict[str, np.ndarray]:
        """Name -> the first frame of each camera as `cameras` see it, full size."""
        return self.footage.first_images(self.undistortion)

    def to_scene(self) -> Scene:
        """Decodes what is not in the store yet."""
        return self.footage.to_scene(self.cameras, self.undistortion, self.unit, self.init_box)


def read_plenoptic(path: str | Path, **options: Any) -> Scene:
    """The scene in folder `path`, in either form of the layout; decodes what is not in the store yet.

    options: the fields of Reading. Raises SceneError for anything that is not as the layout promises, before a frame
    is decoded unless only decoding shows it.
    """
    return open_plenoptic(path, **options).to_scene()


def open_plenoptic(path: str | Path, **options: Any) -> Posed:
    """`read_plenoptic` up to the decoding."""
    root, reading = Path(path), Reading(**options)
    if not root.is_dir():
        raise SceneError(root, "a folder in the Plenoptic Video layout", "a file" if root.exists() else "nothing there")
    files, poses, transforms = find_cameras(root), root / "poses_bounds.npy", root / "transforms_train.json"
    if files and (poses.exists() or not transforms.exists()):
        footage = _footage(root, files, reading)
        found = read_poses(poses, [file.name for file in files], footage.names, footage.size)
        return Posed(footage, found.cameras, unit=found.unit, init_box=found.init_box)
    if transforms.exists():
        return _open_images(root, reading)
    raise SceneError(root, "cam00.mp4 … and poses_bounds.npy, or images and transforms_train.json", "neither")


def read_footage(path: str | Path, **options: Any) -> Footage:
    """The videos in folder `path`, whatever their names, without poses. options: the fields of Reading."""
    root = Path(path)
    return _footage(root, find_footage(root), Reading(**options))


def _footage(root: Path, files: Sequence[VideoFile], reading: Reading) -> Footage:
    keep = choose([file.number for file in files], root, reading.test_cameras, reading.drop_cameras)
    videos = probe(files, keep, reading.drop_cameras)
    count = common_frames(videos, reading.first_frame, reading.frames, reading.drop_cameras)
    return Footage(root, videos, count, fingerprint([file.path for file in files], VIDEO_PART), reading)


def _open_images(root: Path, reading: Reading) -> Posed:
    entries = read_entries(root)
    keep = choose([camera_number(name) for name in entries], root, reading.test_cameras, reading.drop_cameras)
    found = sequences(entries, keep, reading.background)
    count = common_frames(found, reading.first_frame, reading.frames, reading.drop_cameras)
    files = [entry.image_path for camera in entries.values() for entry in camera]
    content = f"{fingerprint(files, IMAGE_PART)} over {reading.background}"
    footage = Footage(root, found, count, content, reading)
    posed = {name: read_camera(entries[name], footage.size) for name in footage.names}
    cameras = {name: camera for name, (camera, _) in posed.items()}
    trained = [camera for name, camera in cameras.items() if name not in footage.held_out]
    return Posed(
        footage, cameras, {name: lens for name, (_, lens) in posed.items()}, unit=canonical_space(trained).unit
    )  # these files have no bounds
