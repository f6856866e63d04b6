"""`DrivingLog`: what a folder of a driving log holds, before images and sweeps are read. All readers return it.

World frame: that of the log's poses, z or -y up, metres. Frames are counted from 0 in the order of time, whatever
number their files have.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np

from datasets.files.errors import SceneError
from rasterizer.camera import Camera


@dataclass(frozen=True)
class SweepPoints:
    """A sweep as it was read, in world coordinates."""

    points: np.ndarray  # (N, 3) float64
    origins: np.ndarray  # (3,) or (N, 3) float64: where the beams start
    note: str = ""  # in what the file differs from its layout, for the log

    @property
    def origin(self) -> np.ndarray:
        """(3,): the median of the beams' starts, where there are several sensors."""
        return self.origins if self.origins.ndim == 1 else np.median(self.origins, axis=0)


@dataclass(frozen=True)
class LogImage:
    """One image of a log."""

    frame: int
    number: int  # of the camera, in the layout's numbering
    time: float  # seconds
    camera: Camera  # of the full-size image
    path: Path
    distortion: tuple[float, ...] = ()  # k1, k2, p1, p2, k3 of cameras/lens.py; empty: none
    sky: Path | None = None  # a mask, > 0 where there is sky
    moving: Path | None = None  # a mask, > 0 on what moves
    truth: Path | None = None  # ground truth, see datasets/ground_truth.py

    @property
    def name(self) -> str:
        """Without the split: "cam2_000012", the part after the underscore is the frame."""
        return f"cam{self.number}_{self.frame:06d}"


@dataclass(frozen=True)
class LogSweep:
    """One sweep of a log, read on demand."""

    frame: int
    time: float  # seconds
    read: Callable[[], SweepPoints]


def log_sweeps(
    files: Mapping[int, Path],
    numbers: Sequence[int],
    times: Sequence[float],
    poses: Sequence[np.ndarray],
    read: Callable[[Path, np.ndarray], SweepPoints],
) -> tuple[LogSweep, ...]:
    """The sweeps of a log. files: by number; numbers, times, poses: of each frame. read: of a file and its pose."""
    return tuple(
        LogSweep(frame, times[frame], partial(read, files[number], poses[frame]))
        for frame, number in enumerate(numbers)
        if number in files
    )


@dataclass(frozen=True)
class DrivingLog:
    layout: str  # "KITTI odometry", …, for messages
    source: Path
    images: tuple[LogImage, ...]
    sweeps: tuple[LogSweep, ...]
    usual_cameras: tuple[int, ...]  # numbers of the cameras that are read by default, those of them that are there

    @property
    def frames(self) -> int:
        return 1 + max(image.frame for image in self.images)


def check_times(times: Sequence[float], where: str | Path) -> None:
    """SceneError unless the times (seconds) are finite and ascend."""
    for index, time in enumerate(times):
        if not np.isfinite(time):
            raise SceneError(where, "finite times", f"{time} at frame {index}")
    for index, (before, after) in enumerate(pairwise(times), 1):
        if after <= before:
            raise SceneError(
                where, "times that ascend", f"{after:.6f} s at frame {index}, after {before:.6f} s: they run back"
            )


def require_frames(folder: Path, files: Mapping[int, Path], numbers: Sequence[int]) -> None:
    """SceneError unless there is a file of each number."""
    if missing := [number for number in numbers if number not in files]:
        raise SceneError(folder, f"a file of frame {missing[0]}", "none")


def numbered_files(folder: Path, suffixes: Sequence[str]) -> dict[int, Path]:
    """The files of a folder whose names are whole numbers, by number, ascending; empty without the folder."""
    if not folder.is_dir():
        return {}
    found = {}
    for path in folder.iterdir():
        if path.suffix.lower() in suffixes and path.stem.isascii() and path.stem.isdigit() and len(path.stem) <= 12:
            found[int(path.stem)] = path
    return dict(sorted(found.items()))
