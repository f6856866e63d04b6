"""Frames of a clip in order, one at a time: a video file or a folder of images."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import av
import av.error
import cv2
import numpy as np

from datasets.composition import BLACK, Color, compose
from datasets.files.errors import SceneError
from datasets.files.image_files import read_rgba
from datasets.files.natural_order import about_even, last_number, natural_order
from datasets.video_files.hdr import tone_mapped
from datasets.video_files.probe import USUAL_RATE, Header, decoded_frames, open_container

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".webp", ".bmp", ".tif", ".tiff")
_TURNS = {90: cv2.ROTATE_90_CLOCKWISE, 180: cv2.ROTATE_180, 270: cv2.ROTATE_90_COUNTERCLOCKWISE}


@dataclass(frozen=True)
class Frame:
    """A decoded frame."""

    index: int  # among the clip's frames, damaged ones included
    time: float  # seconds since the clip's start
    image: np.ndarray | None  # (H, W, 3) uint8 RGB, upright; None: damaged


def video_frames(path: Path, header: Header, keep: set[int] | None = None, every: int = 1) -> Iterator[Frame]:
    """The frames of a video. keep: only these indices; every: only each so many-th. Others are decoded, not converted.

    A damaged frame comes without an image; times are those of the file, so that a varying rate is kept. SceneError for
    a frame of another size than the first.
    """
    size: tuple[int, int] | None = None
    last = max(keep) if keep else None
    index, time = -1, 0.0
    step = 1.0 / header.rate if header.rate else 1.0 / USUAL_RATE
    with open_container(path) as container:
        stream = container.streams.video[0]
        stream.thread_type = "AUTO"
        for decoded in decoded_frames(container):
            index += 1
            if decoded is not None and decoded.time is not None:
                time = float(decoded.time)
            elif index:
                time += step
            if (keep is not None and index not in keep) or index % every:
                if last is not None and index >= last:
                    return
                continue
            if decoded is not None:
                stored = (decoded.width, decoded.height)
                size = size or stored
                if stored != size:
                    raise SceneError(path, f"frames of one size, {_pixels(size)}", f"{_pixels(stored)} at {time:.2f} s")
            damaged = decoded is None or decoded.is_corrupt
            yield Frame(index, time, None if decoded is None or damaged else _upright(decoded, header))
            if last is not None and index >= last:
                return


def frame_times(path: Path) -> np.ndarray:
    """(frames,) seconds at which the frames of a video are shown, ascending, from the packets alone."""
    times = []
    with open_container(path) as container:
        stream = container.streams.video[0]
        try:
            for packet in container.demux(stream):
                if packet.pts is not None and packet.time_base is not None:
                    times.append(float(packet.pts * packet.time_base))
        except av.error.FFmpegError:  # truncated
            pass
    return np.sort(np.array(times))


def image_paths(folder: Path) -> list[Path]:
    """The images of a folder in the natural order of their names."""
    paths = [p for p in folder.iterdir() if p.suffix.lower() in IMAGE_SUFFIXES and not p.name.startswith(".")]
    return sorted(paths, key=lambda path: natural_order(path.name))


def image_times(paths: list[Path]) -> np.ndarray:
    """(images,) seconds since the first: by the numbers in their names if these ascend, so that gaps remain.

    The median step is a frame at USUAL_RATE. Evenly spaced without such numbers.
    """
    found = [last_number(path.stem) for path in paths]
    numbers = np.array(found, dtype=np.float64)  # None becomes NaN
    if not (about_even(found) and (np.diff(numbers) > 0).all()):
        return np.arange(len(paths)) / USUAL_RATE
    return (numbers - numbers[0]) / np.median(np.diff(numbers)) / USUAL_RATE


def image_frames(
    paths: list[Path], keep: set[int] | None = None, every: int = 1, background: Color = BLACK
) -> Iterator[Frame]:
    """Images, upright, as frames at `image_times`; a damaged file comes without an image. SceneError unless all have
    one size.

    background: under transparent pixels.
    """
    first: tuple[str, tuple[int, int]] | None = None
    for index, (path, time) in enumerate(zip(paths, image_times(paths).tolist(), strict=True)):
        if (keep is not None and index not in keep) or index % every:
            continue
        try:
            image = compose(read_rgba(path, upright=True), background)
        except SceneError:
            image = None
        if image is not None:
            stored = (image.shape[1], image.shape[0])
            first = first or (path.name, stored)
            if stored != first[1]:
                raise SceneError(path, f"{_pixels(first[1])}, the size of {first[0]}", _pixels(stored))
        yield Frame(index, time, image)


def _upright(frame: av.VideoFrame, header: Header) -> np.ndarray:
    if header.hdr:
        image = tone_mapped(frame.to_ndarray(format="rgb48le"), header.transfer)
    else:
        image = frame.to_ndarray(format="rgb24")
    if header.pixel_aspect != 1.0:
        stored = header.size if header.rotation % 180 == 0 else header.size[::-1]
        image = cv2.resize(image, stored, interpolation=cv2.INTER_AREA)
    return cv2.rotate(image, _TURNS[header.rotation]) if header.rotation else image


def _pixels(size: tuple[int, int]) -> str:
    return f"{size[0]} x {size[1]} pixels"
