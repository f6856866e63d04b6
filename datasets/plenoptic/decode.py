"""Decodes videos into the frame store: each camera once, several in parallel, resuming after a killed run.

    <cache>/<scene>-<hash>/<camera>.npy, <camera>.json     see datasets/files/frame_store.py

The hash covers everything that determines the frames. It excludes the path of the data set and the dropped cameras,
so that a copied data set, or one with a camera dropped, uses the same store.
"""

from __future__ import annotations

import hashlib
import json
import math
import shutil
import threading
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from datasets.cameras.color import ColorCorrection
from datasets.cameras.lens import Lens, undistort
from datasets.files.atomic_write import TEMPORARY, DiskFull
from datasets.files.claim import claimed
from datasets.files.errors import SceneError
from datasets.files.frame_store import StoredFrame, read_frames, write_frames
from datasets.plenoptic.display import DecodingDisplay
from datasets.source import Log

STORE_VERSION = 2  # to be increased by every change that alters the decoded frames
FEWEST_ALIKE = 4  # frames that are equal to the bit are no film


@dataclass(frozen=True)
class Stream(ABC):
    """One camera's images in use in order of time, all of one size: of a video or a folder of images."""

    name: str  # "cam00"; unique, the name of its file in the store
    number: int  # as in scene.test_cameras and scene.drop_cameras
    path: Path  # the video, or the first image; named in messages
    size: tuple[int, int]  # (width, height)
    rate: float  # of the ticks that all cameras share, per unit of time
    ticks: tuple[int, ...]  # of each image, ascending; one that has no image is left out
    times: tuple[float, ...]  # of each image, in units of time

    @property
    def count(self) -> int:
        return len(self.ticks)

    @abstractmethod
    def read(self, threads: int) -> Iterator[np.ndarray]:
        """Each (height, width, 3) uint8 RGB; SceneError if one cannot be decoded."""


@dataclass(frozen=True)
class Decoding:
    """What is decoded, and how."""

    first_frame: int
    frames: int
    downscale: int
    undistortion: Mapping[str, Lens]  # by the name of the camera; of distorted images
    colors: Mapping[str, ColorCorrection]  # the same, of the cameras whose colours are corrected

    def shape(self, stream: Stream) -> tuple[int, int, int, int]:
        """(frames, height, width, 3) of what is stored of a camera."""
        width, height = stream.size
        return stream.count, height // self.downscale, width // self.downscale, 3

    def folder(self, cache: Path, scene: str, content: str) -> Path:
        """Of a scene's frames. content: hash of all videos or images of the scene, dropped ones included."""
        counts = {"first_frame": self.first_frame, "frames": self.frames, "downscale": self.downscale}
        parts = [STORE_VERSION, content, counts, {name: vars(lens) for name, lens in self.undistortion.items()}]
        if self.colors:
            parts.append({name: vars(color) for name, color in self.colors.items()})
        digest = hashlib.blake2b(json.dumps(parts, sort_keys=True).encode(), digest_size=6).hexdigest()
        return cache / f"{scene.replace('/', '_')}-{digest}"


def reduce_image(image: np.ndarray, downscale: int) -> np.ndarray:
    """(H, W, 3) uint8 -> (H // downscale, W // downscale, 3): area average, without pixels that fill no block."""
    if downscale == 1:
        return image
    height, width = image.shape[0] // downscale, image.shape[1] // downscale
    whole = image[: height * downscale, : width * downscale]
    return cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA)


def decode(
    streams: Sequence[Stream], folder: Path, decoding: Decoding, threads: int, log: Log
) -> dict[str, tuple[StoredFrame, ...]]:
    """Camera -> its frames in `folder`, decoded if they are not there. All streams have one size.

    threads: number of cameras decoded in parallel. Waits for another process that decodes into the same folder. Raises
    SceneError if a video cannot be decoded, a camera's frames are all one, or the disk is full.
    """

    def stored() -> dict[str, tuple[StoredFrame, ...]]:
        """The cameras that are complete."""
        read = {stream.name: read_frames(folder, stream.name, decoding.shape(stream)) for stream in streams}
        return {name: frames for name, frames in read.items() if frames is not None}

    found = stored()
    if len(found) < len(streams):
        folder.mkdir(parents=True, exist_ok=True)
        with claimed(folder, lambda: log(f"waiting for another process that decodes into {folder}")):
            for leftover in folder.glob(f"{TEMPORARY}*"):
                leftover.unlink()
            missing = [stream for stream in streams if read_frames(folder, stream.name, decoding.shape(stream)) is None]
            needed = sum(math.prod(decoding.shape(stream)) for stream in missing)
            free = shutil.disk_usage(folder).free
            if free < needed:
                raise _no_space(folder, needed, free)
            with DecodingDisplay(len(missing), sum(stream.count for stream in missing), log) as display:
                _decode_missing(missing, folder, decoding, threads, display)
        found = stored()
    for stream in streams:
        frames = found[stream.name]
        if len(frames) >= FEWEST_ALIKE and len({frame.checksum for frame in frames}) == 1:
            raise SceneError(
                stream.path,
                "frames that differ",
                f"{len(frames)} that are equal to the bit: a camera that froze, or a file that cannot be decoded; "
                "scene.drop_cameras leaves a camera out",
            )
    return found


def _decode_missing(
    streams: Sequence[Stream], folder: Path, decoding: Decoding, threads: int, display: DecodingDisplay
) -> None:
    stop = threading.Event()  # ends the other threads after an error or Ctrl-C
    threads_each = max(1, threads // max(1, len(streams)))

    def decode_one(stream: Stream) -> None:
        shape = decoding.shape(stream)
        images = _reduced_frames(stream, decoding, threads_each, stop, display)
        facts = {
            "source": stream.path.name,
            "ticks": stream.ticks,
            "downscale": decoding.downscale,
            "store_version": STORE_VERSION,
        }
        try:
            write_frames(folder, stream.name, shape, images, facts)
        except DiskFull:
            raise _no_space(folder, math.prod(shape), shutil.disk_usage(folder).free) from None
        display.camera(stream.name)

    with ThreadPoolExecutor(max_workers=max(1, threads)) as pool:
        futures = [pool.submit(decode_one, stream) for stream in streams]
        try:
            for future in as_completed(futures):
                future.result()
        except BaseException:
            stop.set()
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _reduced_frames(
    stream: Stream, decoding: Decoding, threads: int, stop: threading.Event, display: DecodingDisplay
) -> Iterator[np.ndarray]:
    """A camera's frames as they are stored: corrected in colour, undistorted and reduced."""
    lens, color = decoding.undistortion.get(stream.name), decoding.colors.get(stream.name)
    maps = lens.maps(stream.size) if lens else None
    for image in stream.read(threads):
        if stop.is_set():
            raise RuntimeError("decoding was stopped")  # not shown: the error that set `stop` is raised instead
        if color is not None:
            image = color.apply(image)
        if maps is not None:
            image = undistort(image, maps)
        yield reduce_image(image, decoding.downscale)
        display.frame()


def _no_space(folder: Path, needed: int, free: int) -> SceneError:
    return SceneError(
        folder,
        f"{needed / 1e9:.1f} GB free for the decoded frames",
        f"{free / 1e9:.1f} GB; scene.cache=DIR puts them elsewhere, scene.downscale makes them smaller",
    )
