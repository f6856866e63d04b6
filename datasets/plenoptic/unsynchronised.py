"""Cameras that started at different times, with different rates and sizes: frames near the ticks of one clock.

Each camera gives the frame nearest to each tick, so that all have as many; its time stays its own, also between the
ticks. Gaussians in 4D take any time.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from datasets.files.errors import SceneError
from datasets.plenoptic.decode import Stream
from datasets.plenoptic.sync import RATE_TOLERANCE
from datasets.plenoptic.videos import Video
from datasets.sync.offsets import Offsets

SAME_START = 0.5  # frames: cameras that start nearer to each other than this, at one rate, are synchronised
FEWEST_TICKS = 4


@dataclass(frozen=True)
class AlignedStream(Stream):
    """The chosen frames of a video, scaled to cover `size` and cropped to it."""

    video: Video
    indices: tuple[int, ...]  # of the video's frames, ascending; may repeat
    times: tuple[float, ...]  # seconds on the common clock, of each

    def read(self, first: int, count: int, threads: int) -> Iterator[np.ndarray]:
        """Chosen frames first … first + count - 1."""
        wanted = self.indices[first : first + count]
        start = wanted[0]
        frames = enumerate(self.video.read(start, wanted[-1] - start + 1, threads), start)
        index, image = next(frames)
        for target in wanted:
            while index < target:
                index, image = next(frames)
            yield covering(image, self.size)


def covering(image: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """The image scaled to cover (width, height), its middle."""
    width, height = size
    if image.shape[:2] == (height, width):
        return image
    scale = max(width / image.shape[1], height / image.shape[0])
    larger = max(width, round(image.shape[1] * scale)), max(height, round(image.shape[0] * scale))
    interpolation = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    resized = cv2.resize(image, larger, interpolation=interpolation)
    left, top = (larger[0] - width) // 2, (larger[1] - height) // 2
    return np.ascontiguousarray(resized[top : top + height, left : left + width])


def is_synchronised(videos: Sequence[Video], offsets: Offsets) -> bool:
    """Whether the cameras have one size and rate, and started within half a frame, without drift."""
    first = videos[0]
    starts = np.array(offsets.seconds) * first.rate
    return (
        all(v.size == first.size and abs(v.rate - first.rate) <= RATE_TOLERANCE * first.rate for v in videos)
        and float(np.ptp(starts)) < SAME_START
        and not any(offsets.drift)
    )


def align(videos: Sequence[Video], offsets: Offsets, first_frame: int, frames: int) -> tuple[AlignedStream, ...]:
    """Streams of as many frames each, over the time that all cameras filmed. SceneError if that is too short.

    The clock ticks at the lowest rate of the cameras; their common size is the smallest of each side.
    """
    starts = np.array(offsets.seconds)
    speeds = 1.0 / (1.0 + np.array(offsets.drift))  # seconds of a camera's clock per second of the common one
    ends = starts + np.array([(v.count - 1) / v.rate for v in videos]) / speeds
    low, high = float(starts.max()), float(ends.min())
    rate = min(v.rate for v in videos)
    ticks = low + np.arange(max(0, int((high - low) * rate) + 1)) / rate
    ticks = ticks[first_frame : first_frame + frames]
    if len(ticks) < FEWEST_TICKS:
        late = videos[int(starts.argmax())]
        raise SceneError(
            late.path,
            f"at least {FEWEST_TICKS} frames that all cameras filmed at the same time",
            f"{len(ticks)}: the last camera starts at {low:.2f} s, the first one ends at {high:.2f} s",
        )
    size = min(v.size[0] for v in videos), min(v.size[1] for v in videos)
    found = []
    for video, start, speed in zip(videos, starts, speeds):
        index = np.clip(np.rint((ticks - start) * speed * video.rate).astype(int), 0, video.count - 1)
        times = start + index / (video.rate * speed)
        found.append((video, tuple(index.tolist()), times))
    origin = min(float(times[0]) for _, _, times in found)
    return tuple(
        AlignedStream(
            video.name,
            video.number,
            video.path,
            size,
            rate,
            len(ticks),
            0.0,
            video,
            index,
            tuple((times - origin).tolist()),
        )
        for video, index, times in found
    )
