"""Fills the decoded-frame store: every camera once, several side by side, going on where a killed run stopped.

    <cache>/<scene>-<hash>/<camera>.npy, <camera>.json     see datasets/files/frame_store.py

The hash is that of everything the frames follow from, but not of the place the data lie in or the cameras that are
left out: a copied data set, or one with a camera dropped, finds its frames.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import math
import os
import shutil
import threading
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import cv2
import numpy as np

from datasets.cameras.lens import Undistortion, straighten
from datasets.files.atomic_write import TEMPORARY, DiskFull
from datasets.files.frame_store import StoredFrame, read_frames, write_frames
from datasets.plenoptic.display import DecodingDisplay, Log
from datasets.scene import SceneError
from rasterizer.camera import Camera

STORE_VERSION = 1  # raised whenever the same input would give other frames


class Stream(Protocol):
    """One camera's images in order of time, all of one size."""

    name: str  # "cam00"; unique, names its file in the store
    number: int  # as in scene.test_cameras and scene.drop_cameras
    path: Path  # the video, or what stands for it in a message
    size: tuple[int, int]  # (width, height)
    rate: float  # frames a second
    count: int  # frames its header promises
    start: float  # when the first frame was taken, in frames

    def read(self, first: int, count: int, threads: int) -> Iterator[np.ndarray]:
        """Frames first … first + count - 1, each (height, width, 3) uint8 RGB; SceneError if one cannot be had."""
        ...


@dataclass(frozen=True)
class Recipe:
    """What is done to every camera."""

    first_frame: int
    frames: int
    downscale: int


def reduce_image(image: np.ndarray, downscale: int) -> np.ndarray:
    """(H, W, 3) uint8 -> (H // downscale, W // downscale, 3): area average, less what fills no block at the end."""
    if downscale == 1:
        return image
    height, width = image.shape[0] // downscale, image.shape[1] // downscale
    whole = image[: height * downscale, : width * downscale]
    return cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA)


def reduce_camera(camera: Camera, downscale: int) -> Camera:
    """The camera of `reduce_image`: first the part that is kept (intrinsics from the top left stay), then its scale."""
    width, height = camera.width // downscale, camera.height // downscale
    return replace(camera, width=width * downscale, height=height * downscale).resized(width, height)


def store_folder(
    cache: Path, scene: str, content: str, recipe: Recipe, undistortion: Mapping[str, Undistortion]
) -> Path:
    """Where a scene's frames lie.

    content: hash of the videos or images, all in the folder, whether left out or not.
    """
    parts = (STORE_VERSION, content, vars(recipe), {name: vars(lens) for name, lens in undistortion.items()})
    digest = hashlib.blake2b(json.dumps(parts, sort_keys=True).encode(), digest_size=6).hexdigest()
    return cache / f"{scene.replace('/', '_')}-{digest}"


def fingerprint(paths: Sequence[Path], part: int) -> str:
    """Hash of each file's name, size, and first and last `part` bytes: a copy has the same, an edited file another."""
    digest = hashlib.blake2b(digest_size=16)
    for path in paths:
        try:
            with open(path, "rb") as file:
                size = file.seek(0, os.SEEK_END)
                digest.update(f"{path.name}\n{size}\n".encode())
                file.seek(0)
                digest.update(file.read(part))
                file.seek(max(size - part, 0))
                digest.update(file.read(part))
        except OSError as error:
            raise SceneError(path, "a readable file", str(error)) from None
    return digest.hexdigest()


def decode(
    streams: Sequence[Stream],
    folder: Path,
    recipe: Recipe,
    undistortion: Mapping[str, Undistortion],
    threads: int,
    log: Log,
) -> dict[str, tuple[StoredFrame, ...]]:
    """Camera -> its frames in `folder`, decoded now unless they are there. All streams are of one size.

    threads: cameras decoded side by side. Another process that decodes into the same folder is waited for. Raises
    SceneError for a video that cannot be decoded as promised, or a disk without room.
    """
    width, height = streams[0].size
    shape = (recipe.frames, height // recipe.downscale, width // recipe.downscale, 3)
    found = {stream.name: read_frames(folder, stream.name, shape) for stream in streams}
    if None in found.values():
        folder.mkdir(parents=True, exist_ok=True)
        with _locked(folder, log):
            for leftover in folder.glob(f"{TEMPORARY}*"):
                leftover.unlink()
            missing = [stream for stream in streams if read_frames(folder, stream.name, shape) is None]
            _check_space(folder, len(missing) * math.prod(shape))
            with DecodingDisplay(len(missing), recipe.frames, log) as display:
                _decode_missing(missing, folder, shape, recipe, undistortion, threads, display)
        found = {stream.name: read_frames(folder, stream.name, shape) for stream in streams}
    return found


def _decode_missing(
    streams: Sequence[Stream],
    folder: Path,
    shape: tuple[int, int, int, int],
    recipe: Recipe,
    undistortion: Mapping[str, Undistortion],
    threads: int,
    display: DecodingDisplay,
) -> None:
    stop = threading.Event()  # an error, or Ctrl-C, must not wait for minutes of decoding in the other threads
    each = max(1, threads // max(1, len(streams)))  # threads of one decoder

    def one(stream: Stream) -> None:
        images = _prepared(stream, recipe, undistortion.get(stream.name), each, stop, display)
        facts = {
            "source": stream.path.name,
            "rate": stream.rate,
            "first_frame": recipe.first_frame,
            "downscale": recipe.downscale,
            "store_version": STORE_VERSION,
        }
        try:
            write_frames(folder, stream.name, shape, images, facts)
        except DiskFull:
            raise _no_space(folder, math.prod(shape), shutil.disk_usage(folder).free) from None
        display.camera(stream.name)

    with ThreadPoolExecutor(max_workers=max(1, threads)) as pool:
        futures = [pool.submit(one, stream) for stream in streams]
        try:
            for future in as_completed(futures):
                future.result()
        except BaseException:
            stop.set()
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _prepared(
    stream: Stream,
    recipe: Recipe,
    lens: Undistortion | None,
    threads: int,
    stop: threading.Event,
    display: DecodingDisplay,
) -> Iterator[np.ndarray]:
    """A camera's frames as they are stored."""
    maps = lens.maps(stream.size) if lens else None
    for image in stream.read(recipe.first_frame, recipe.frames, threads):
        if stop.is_set():
            raise RuntimeError("decoding was stopped")  # seen by nobody: the error that stopped it is raised
        if maps is not None:
            image = straighten(image, maps)
        yield reduce_image(image, recipe.downscale)
        display.frame()


def _check_space(folder: Path, needed: int) -> None:
    free = shutil.disk_usage(folder).free
    if free < needed:
        raise _no_space(folder, needed, free)


def _no_space(folder: Path, needed: int, free: int) -> SceneError:
    return SceneError(
        folder,
        f"{needed / 1e9:.1f} GB free for the decoded frames",
        f"{free / 1e9:.1f} GB; scene.cache=DIR puts them elsewhere, scene.downscale makes them smaller",
    )


@contextmanager
def _locked(folder: Path, log: Log) -> Iterator[Any]:
    with open(folder / ".lock", "w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            log(f"waiting for another process that decodes into {folder}")
            fcntl.flock(lock, fcntl.LOCK_EX)
        yield lock
