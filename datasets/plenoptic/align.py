"""Several cameras' films on one clock, by their time stamps: of each camera the frame nearest to each tick.

A tick without an intact frame within half a step is left out of that camera. A frame's time stays its own, also between
the ticks: Gaussians in 4D take any time.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from datasets.files.errors import SceneError
from datasets.plenoptic.decode import Stream
from datasets.plenoptic.sync import RATE_TOLERANCE, ROUNDING, on_ticks, require_equal
from datasets.plenoptic.videos import Video
from datasets.sync.offsets import Offsets
from datasets.video_files.film import Film

FEWEST_TICKS = 4
MOST_MISSING = 0.5  # of the ticks in use
CODEC_PADDING = 15  # pixels: codecs code blocks of 16, and some files show all of them: 1088 lines for 1080
NAMED = 6  # ticks in a line


@dataclass(frozen=True)
class FilmStream(Stream):
    """The chosen frames of a film, scaled to cover `size` and cropped to it."""

    film: Film
    indices: tuple[int, ...]  # of the film's frames, ascending

    def read(self, threads: int) -> Iterator[np.ndarray]:
        for frame in self.film.frames(set(self.indices), threads=threads):
            if frame.image is None:
                raise SceneError(self.path, "the file that was opened before", f"another, frame {frame.index} damaged")
            yield covering(frame.image, self.size)


def padded(size: tuple[int, int], other: tuple[int, int]) -> bool:
    """Whether sizes (width, height) differ by no more than the padding that codecs add at the right and below."""
    return all(abs(a - b) <= CODEC_PADDING for a, b in zip(size, other, strict=True))


def covering(image: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """The image scaled to cover (width, height), its middle; of one with a codec's padding what is not padding."""
    width, height = size
    if image.shape[:2] == (height, width):
        return image
    if image.shape[1] >= width and image.shape[0] >= height and padded((image.shape[1], image.shape[0]), size):
        return np.ascontiguousarray(image[:height, :width])
    scale = max(width / image.shape[1], height / image.shape[0])
    larger = max(width, round(image.shape[1] * scale)), max(height, round(image.shape[0] * scale))
    interpolation = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    resized = cv2.resize(image, larger, interpolation=interpolation)
    left, top = (larger[0] - width) // 2, (larger[1] - height) // 2
    return np.ascontiguousarray(resized[top : top + height, left : left + width])


def synchronised(videos: Sequence[Video], first_frame: int, frames: int) -> tuple[FilmStream, ...]:
    """Streams of cameras whose files have one clock, over the time that most filmed.

    SceneError if sizes or rates differ, if a frame at equal steps is asked for beyond the end, or if a camera lacks
    more than MOST_MISSING of the ticks.
    """
    require_equal(
        _named(videos), " pixels", [v.film.size for v in videos], "{0[0]} x {0[1]}".format, absolute=CODEC_PADDING
    )
    size = min(v.film.size[0] for v in videos), min(v.film.size[1] for v in videos)
    even = [v for v in videos if v.film.even]
    require_equal(_named(even), " frames a second", [v.film.rate for v in even], "{:.6g}".format, RATE_TOLERANCE)
    rate = Counter(v.film.rate for v in even or videos).most_common(1)[0][0]
    # Of two cameras the earlier start and the later end; of more those in the middle.
    low = float(np.sort([v.film.times[0] for v in videos])[(len(videos) - 1) // 2])
    high = float(np.sort([v.film.times[-1] for v in videos])[len(videos) // 2])
    ticks = _ticks(low, high, rate)
    if len(ticks) <= first_frame:
        raise SceneError(
            f"{videos[0].path.parent}: scene.first_frame",
            f"below the {len(ticks)} frames of each camera",
            f"{first_frame}",
        )
    numbers = np.arange(len(ticks))[first_frame : first_frame + frames]
    streams = tuple(_stream(v, size, rate, numbers, ticks[numbers], v.film.times, low) for v in videos)
    for video, stream in zip(videos, streams, strict=True):
        if stream.count < (1 - MOST_MISSING) * len(numbers) or not stream.count:
            film = video.film
            raise SceneError(
                video.path,
                f"frames at {len(numbers)} times, {ticks[numbers[0]]:.3f} to {ticks[numbers[-1]]:.3f} s, as the others",
                f"{stream.count}, {int(film.intact.sum())} intact frames from {film.times[0]:.3f} to "
                f"{film.times[-1]:.3f} s: truncated or unsynchronised; {video.advice}",
            )
    return on_ticks(streams, first_frame)


def aligned(videos: Sequence[Video], offsets: Offsets, first_frame: int, frames: int) -> tuple[FilmStream, ...]:
    """Streams over the time that all cameras filmed. SceneError if that is too short.

    The clock ticks at the lowest rate of the cameras; their common size is the smallest of each side.
    """
    starts = np.array(offsets.seconds)
    common = [start + (1 + drift) * v.film.times for v, start, drift in zip(videos, starts, offsets.drift, strict=True)]
    low, high = max(float(times[0]) for times in common), min(float(times[-1]) for times in common)
    rate = min(v.film.rate for v in videos)
    ticks = _ticks(low, high, rate)
    numbers = np.arange(len(ticks))[first_frame : first_frame + frames]
    if len(numbers) < FEWEST_TICKS:
        raise SceneError(
            videos[int(np.argmax([times[0] for times in common]))].path,
            f"at least {FEWEST_TICKS} frames that all cameras filmed at the same time",
            f"{len(numbers)}: the last camera starts at {low:.2f} s, the first one ends at {high:.2f} s",
        )
    size = min(v.film.size[0] for v in videos), min(v.film.size[1] for v in videos)
    streams = [
        _stream(video, size, rate, numbers, ticks[numbers], times, 0.0)
        for video, times in zip(videos, common, strict=True)
    ]
    for stream in streams:
        if not stream.count:
            raise SceneError(stream.path, "an intact frame in the time that all cameras filmed", "none")
    origin = min(stream.times[0] for stream in streams)
    return tuple(replace(stream, times=tuple(time - origin for time in stream.times)) for stream in streams)


def left_out(stream: Stream, first_frame: int, count: int) -> str | None:
    """Which of the `count` ticks in use have no frame, for the user; None if none."""
    missing = sorted(set(range(first_frame, first_frame + count)) - set(stream.ticks))
    if not missing:
        return None
    named = ", ".join(map(str, missing[:NAMED])) + (", …" if len(missing) > NAMED else "")
    return f"no intact frame at {len(missing)} of {count} times, which are left out: {named}"


def _named(videos: Sequence[Video]) -> list[tuple[Path, str]]:
    return [(video.path, video.advice) for video in videos]


def _ticks(low: float, high: float, rate: float) -> np.ndarray:
    """(N,) seconds."""
    return low + np.arange(max(0, int((high - low) * rate + ROUNDING) + 1)) / rate


def _stream(
    video: Video,
    size: tuple[int, int],
    rate: float,
    numbers: np.ndarray,
    ticks: np.ndarray,
    times: np.ndarray,
    origin: float,
) -> FilmStream:
    """The intact frame nearest to each tick, if within half a step. numbers: of the ticks; times: of all frames."""
    intact = np.flatnonzero(video.film.intact)
    own = times[intact]
    if not len(own):
        return FilmStream(video.name, video.number, video.path, size, rate, (), (), video.film, ())
    after = np.clip(np.searchsorted(own, ticks), 1, max(len(own) - 1, 1))
    before = after - 1
    after = np.minimum(after, len(own) - 1)
    nearest = np.where(ticks - own[before] <= own[after] - ticks, before, after)
    near = np.flatnonzero(np.abs(own[nearest] - ticks) <= 0.5 / rate * (1 + 1e-6))
    chosen, first = np.unique(nearest[near], return_index=True)  # each frame once
    near = near[first]
    return FilmStream(
        name=video.name,
        number=video.number,
        path=video.path,
        size=size,
        rate=rate,
        ticks=tuple(numbers[near].tolist()),
        times=tuple((own[chosen] - origin).tolist()),
        film=video.film,
        indices=tuple(intact[chosen].tolist()),
    )
