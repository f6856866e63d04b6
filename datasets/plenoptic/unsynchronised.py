"""Cameras that started at different times, with different rates and sizes: frames near the ticks of one clock.

Each camera gives the frame nearest to each tick, so that all have as many; its time stays its own, also between the
ticks. Gaussians in 4D take any time.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from datasets.files.errors import SceneError
from datasets.plenoptic.decode import Stream
from datasets.plenoptic.sync import RATE_TOLERANCE
from datasets.plenoptic.videos import Video
from datasets.source import Log
from datasets.sync.offsets import Offsets, find_offsets
from datasets.video_files.decode import frame_times

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


def offsets_of(
    root: Path, videos: Sequence[Video], sync: str, given: Sequence[float], log: Log, moving: bool = False
) -> Offsets | None:
    """Starts of the cameras, given (sync=given) or found, with a line of what was found; None: taken as synchronised.

    moving: a camera moves, so that only the sound is asked. SceneError where neither sound nor picture decides and the
    videos differ in size, rate or length, or a camera moves.
    """
    if sync == "given":
        if len(given) != len(videos):
            raise SceneError(
                f"{root}: scene.offsets",
                f"{len(videos)} numbers, the seconds at which {', '.join(video.name for video in videos)} started",
                f"{len(given)}",
            )
        seconds = tuple(float(s) - float(given[0]) for s in given)
        found = Offsets(seconds, (0.0,) * len(videos), "given", (float("inf"),) * len(videos), 0.0)
    else:
        searched = find_offsets([video.path for video in videos], picture=not moving)
        if searched is None:
            if moving or len({(video.size, video.rate, video.count) for video in videos}) > 1:
                clue = "sound that all cameras hear" if moving else "sound, or motion that all cameras see"
                raise SceneError(
                    root,
                    f"{clue}, to find out when each camera started",
                    f"{'it does not decide' if moving else 'neither decides'}; scene.sync=given scene.offsets=[0,…] "
                    "states the seconds at which each started, scene.sync=none takes them as synchronised; film 6 "
                    "seconds and more, a clap makes it certain",
                )
            log(
                "neither sound nor picture says when each camera started; of one size, rate and length they are taken "
                "as synchronised (scene.sync=given scene.offsets=[0,…] if they are not)"
            )
            return None
        found = searched
    for line in found.lines([video.name for video in videos]):
        log(line)
    return found


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
    """Whether the cameras have one size and rate, and frames of one number within half a frame, without drift."""
    first = videos[0]
    starts = np.array(offsets.seconds)
    if (
        any(v.size != first.size or abs(v.rate - first.rate) > RATE_TOLERANCE * first.rate for v in videos)
        or float(np.ptp(starts * first.rate)) >= SAME_START
        or any(offsets.drift)
    ):
        return False
    shortest = min(v.count for v in videos)
    times = np.stack([start + _times(video)[:shortest] for video, start in zip(videos, starts)])
    return float(np.ptp(times, axis=0).max()) < SAME_START / first.rate


def _times(video: Video) -> np.ndarray:
    """(count,) seconds of the video's frames on its own clock: the file's, or evenly spaced where it has none."""
    times = frame_times(video.path)[: video.count]
    return times if len(times) == video.count else np.arange(video.count) / video.rate


def _nearest(times: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """The index of the value of `times`, ascending, nearest to each of `wanted`."""
    after = np.clip(np.searchsorted(times, wanted), 1, len(times) - 1)
    return np.where(wanted - times[after - 1] <= times[after] - wanted, after - 1, after)


def align(videos: Sequence[Video], offsets: Offsets, first_frame: int, frames: int) -> tuple[AlignedStream, ...]:
    """Streams of as many frames each, over the time that all cameras filmed. SceneError if that is too short.

    The clock ticks at the lowest rate of the cameras; their common size is the smallest of each side.
    """
    starts = np.array(offsets.seconds)
    speeds = 1.0 / (1.0 + np.array(offsets.drift))  # seconds of a camera's clock per second of the common one
    own = [_times(video) for video in videos]
    ends = starts + np.array([times[-1] for times in own]) / speeds
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
    for video, start, speed, times in zip(videos, starts, speeds, own):
        index = _nearest(times, (ticks - start) * speed)
        found.append((video, tuple(index.tolist()), start + times[index] / speed))
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
