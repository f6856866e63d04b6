"""Finds the video files of a folder, checks their headers and decodes their frames with OpenCV (FFmpeg).

Frames of high dynamic range or without square pixels are decoded as those of clips are (datasets/video_files).
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from datasets.files.errors import SceneError
from datasets.files.natural_order import natural_order
from datasets.plenoptic.decode import Stream
from datasets.plenoptic.sync import drop_advice
from datasets.video_files.decode import frame_times, video_frames
from datasets.video_files.probe import Header, open_container
from datasets.video_files.probe import probe as read_header

FOOTAGE_SUFFIXES = (".mp4", ".mov", ".mkv", ".avi", ".m4v", ".webm")
PLENOPTIC_NAME = re.compile(r"cam_?(\d+)\.mp4", re.IGNORECASE)

# Errors are reported in one SceneError; FFmpeg's own output on stderr is turned off.
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # AV_LOG_QUIET; takes effect when the first video is opened


@dataclass(frozen=True)
class VideoFile:
    """A camera's video, not opened yet."""

    name: str
    number: int
    path: Path


@dataclass(frozen=True)
class Video(Stream):
    """A camera's video with the values of its header."""

    advice: str  # the setting that drops this camera, for messages
    header: Header

    @property
    def converted(self) -> bool:
        """Whether the stored pixels are not those of the frames: tone-mapped, or made square."""
        return self.header.hdr is not None or self.header.pixel_aspect != 1

    def read(self, first: int, count: int, threads: int) -> Iterator[np.ndarray]:
        """Frames first … first + count - 1, each (height, width, 3) uint8 RGB.

        Earlier frames are decoded and discarded, because seeking is not exact in all files.
        """
        index = first
        for image in self._as_shown(first, count) if self.converted else self._as_stored(first, count, threads):
            if image is None or image.shape != (self.size[1], self.size[0], 3):
                raise SceneError(
                    f"{self.path}: frame {index}",
                    "{} x {} pixels in colour".format(*self.size),
                    "none: damaged" if image is None else "{1} x {0}".format(*image.shape),
                )
            yield image
            index += 1
        if index < first + count:
            found = f"{index}" if index > first else f"at most {index}"  # earlier ones are not counted
            raise SceneError(
                self.path, f"{self.count} frames as its header promises", f"{found}, a truncated video; {self.advice}"
            )

    def _as_stored(self, first: int, count: int, threads: int) -> Iterator[np.ndarray | None]:
        """The frames up to the end of the file; None: damaged."""
        capture = open_video(self.path, threads, self.advice)
        try:
            for index in range(first + count):
                if not capture.grab():
                    return
                if index >= first:
                    decoded, image = capture.retrieve()
                    yield cv2.cvtColor(image, cv2.COLOR_BGR2RGB) if decoded else None
        except cv2.error as error:
            raise SceneError(self.path, "a video that can be decoded", f"{error}; {self.advice}") from None
        finally:
            capture.release()

    def _as_shown(self, first: int, count: int) -> Iterator[np.ndarray | None]:
        """The same, as a player shows them."""
        return (frame.image for frame in video_frames(self.path, self.header, set(range(first, first + count))))


def find_cameras(root: Path) -> list[VideoFile]:
    """cam00.mp4, cam01.mp4, … of a folder, also cam_00.mp4 and in upper case, sorted by name as their poses are.

    A camera's number is the one in the name. Gaps are allowed.
    """
    return [
        VideoFile(path.stem, int(found[1]), path)
        for path in sorted(root.iterdir(), key=lambda path: path.name)
        if (found := PLENOPTIC_NAME.fullmatch(path.name))
    ]


def video_paths(folder: Path) -> list[Path]:
    """The videos of a folder, sorted. Hidden files are not the user's: file managers write them."""
    return sorted(p for p in folder.iterdir() if p.suffix.lower() in FOOTAGE_SUFFIXES and not p.name.startswith("."))


def find_footage(root: Path) -> list[VideoFile]:
    """All videos of a folder, in the natural order of their names.

    A camera's number is the one that its name ends in, if all names end in different ones, else its place.
    """
    if not root.is_dir():
        found = "a file" if root.exists() else "nothing there"
        raise SceneError(root, "a video, or a folder of videos or images in order", found)
    paths = sorted(video_paths(root), key=lambda path: natural_order(path.name))
    if not paths:
        raise SceneError(root, f"videos ({', '.join(FOOTAGE_SUFFIXES)}) or images in order", "none")
    stems = [path.stem for path in paths]
    for path in paths:
        if stems.count(path.stem) > 1:
            raise SceneError(path, "one video a camera", f"several called {path.stem}")
    stated = [int(end[0]) for stem in stems if (end := re.search(r"[0-9]+$", stem))]
    numbers = stated if len(set(stated)) == len(paths) else range(len(paths))
    return [VideoFile(path.stem, number, path) for number, path in zip(numbers, paths, strict=True)]


def probe(
    files: Sequence[VideoFile], keep: Collection[int], drop: Collection[int], square: bool = True
) -> tuple[Video, ...]:
    """The videos of the cameras `keep`, with header and first frame checked.

    drop: the cameras dropped already, for the advice in messages. square: frames have square pixels; otherwise those
    that are stored.
    """
    return tuple(_probe(file, drop_advice(file.number, drop), square) for file in files if file.number in keep)


def open_video(path: Path, threads: int, advice: str) -> cv2.VideoCapture:
    """Opens a video to be decoded by `threads` threads; SceneError if FFmpeg cannot."""
    level = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG, [cv2.CAP_PROP_N_THREADS, threads])
        opened = capture.isOpened()
    except cv2.error:
        opened = False
    finally:
        cv2.utils.logging.setLogLevel(level)
    if not opened:
        raise SceneError(path, "a video", f"a file that cannot be opened as one; {advice}")
    return capture


def _probe(file: VideoFile, advice: str, square: bool) -> Video:
    capture = open_video(file.path, 1, advice)
    try:
        width, height, count, rate = (
            capture.get(key)
            for key in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT, cv2.CAP_PROP_FRAME_COUNT, cv2.CAP_PROP_FPS)
        )
        count = _frame_count(file.path, count)
        if not (0 < rate < math.inf and 0 < count < math.inf and min(width, height) >= 1 and capture.grab()):
            raise SceneError(
                file.path,
                "a length, a rate and a first frame that can be decoded",
                f"{count:.0f} frames at {rate:g} a second, and no first frame; {advice}",
            )
        start = capture.get(cv2.CAP_PROP_PTS)
    except cv2.error as error:
        raise SceneError(file.path, "a first frame that can be decoded", f"{error}; {advice}") from None
    finally:
        capture.release()
    header, stored = read_header(file.path), (int(width), int(height))
    if not square:
        header = replace(header, size=stored, pixel_aspect=1.0)
    video = Video(file.name, file.number, file.path, stored, rate, int(count), start, advice, header)
    return replace(video, size=header.size) if video.converted else video


def _frame_count(path: Path, stated: float) -> float:
    """Frames of a video: OpenCV's number `stated`, which is an estimate where the header has none (Matroska)."""
    with open_container(path) as container:
        if container.streams.video[0].frames:
            return stated
    return len(frame_times(path)) or stated
