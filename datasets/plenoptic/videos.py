"""Finds the video files of a folder, checks their headers and decodes their frames with OpenCV (FFmpeg)."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from datasets.files.errors import SceneError
from datasets.plenoptic.decode import Stream
from datasets.plenoptic.sync import drop_advice
from datasets.video_files.decode import frame_times
from datasets.video_files.probe import open_container

FOOTAGE_SUFFIXES = (".mp4", ".mov", ".mkv", ".avi")
PLENOPTIC_NAME = re.compile(r"cam(\d+)\.mp4")

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

    def read(self, first: int, count: int, threads: int) -> Iterator[np.ndarray]:
        """Frames first … first + count - 1, each (height, width, 3) uint8 RGB.

        Earlier frames are decoded and discarded, because seeking is not exact in all files.
        """
        capture = open_video(self.path, threads, self.advice)
        try:
            for index in range(first + count):
                if not capture.grab():
                    raise SceneError(
                        self.path,
                        f"{self.count} frames as its header promises",
                        f"{index}, a truncated video; {self.advice}",
                    )
                if index >= first:
                    yield self._retrieve(capture, index)
        except cv2.error as error:
            raise SceneError(self.path, "a video that can be decoded", f"{error}; {self.advice}") from None
        finally:
            capture.release()

    def _retrieve(self, capture: cv2.VideoCapture, index: int) -> np.ndarray:
        decoded, image = capture.retrieve()
        if not decoded or image.shape != (self.size[1], self.size[0], 3):
            raise SceneError(
                f"{self.path}: frame {index}",
                "{} x {} pixels in colour".format(*self.size),
                "{1} x {0}".format(*image.shape) if decoded else "none: damaged",
            )
        return cv2.cvtColor(image, cv2.COLOR_BGR2RGB)


def find_cameras(root: Path) -> list[VideoFile]:
    """cam00.mp4, cam01.mp4, … of a folder, sorted; a camera's number is the one in the name. Gaps are allowed."""
    return [
        VideoFile(path.stem, int(found[1]), path)
        for path in sorted(root.iterdir(), key=lambda path: path.name)
        if (found := PLENOPTIC_NAME.fullmatch(path.name))
    ]


def find_footage(root: Path) -> list[VideoFile]:
    """All videos of a folder, sorted by name; a camera's number is its index in that order."""
    if not root.is_dir():
        found = "a file" if root.exists() else "nothing there"
        raise SceneError(root, "a video, or a folder of videos or images in order", found)
    # Hidden files are not the user's: file managers write them.
    paths = sorted(
        path for path in root.iterdir() if path.suffix.lower() in FOOTAGE_SUFFIXES and not path.name.startswith(".")
    )
    if not paths:
        raise SceneError(root, f"videos ({', '.join(FOOTAGE_SUFFIXES)}) or images in order", "none")
    stems = [path.stem for path in paths]
    for path in paths:
        if stems.count(path.stem) > 1:
            raise SceneError(path, "one video a camera", f"several called {path.stem}")
    return [VideoFile(path.stem, number, path) for number, path in enumerate(paths)]


def probe(files: Sequence[VideoFile], keep: Collection[int], drop: Collection[int]) -> tuple[Video, ...]:
    """The videos of the cameras `keep`, with header and first frame checked.

    drop: the cameras dropped already, for the advice in messages.
    """
    return tuple(_probe(file, drop_advice(file.number, drop)) for file in files if file.number in keep)


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


def _probe(file: VideoFile, advice: str) -> Video:
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
    return Video(file.name, file.number, file.path, (int(width), int(height)), rate, int(count), start, advice)


def _frame_count(path: Path, stated: float) -> float:
    """Frames of a video: OpenCV's number `stated`, which is an estimate where the header has none (Matroska)."""
    with open_container(path) as container:
        if container.streams.video[0].frames:
            return stated
    return len(frame_times(path)) or stated
