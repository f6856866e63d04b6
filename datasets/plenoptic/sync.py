"""Checks that cameras are synchronised: one size, one frame rate, one start, enough frames; their times on ticks."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from datasets.files.errors import SceneError
from datasets.plenoptic.decode import Stream

S = TypeVar("S", bound=Stream)

RATE_TOLERANCE = 1.5e-3  # relative: accepts 29.97 beside 30 frames a second
ROUNDING = 0.1  # frames: images that are later or earlier by less are at equal steps


def select_cameras(numbers: Sequence[int], root: Path, test: Collection[int], drop: Collection[int]) -> tuple[int, ...]:
    """`numbers` without `drop`. SceneError for unknown numbers, or if no training camera is left."""
    for number in numbers:
        if numbers.count(number) > 1:
            raise SceneError(root, "one name a camera", f"several with number {number}")
    for key, chosen in (("scene.test_cameras", test), ("scene.drop_cameras", drop)):
        unknown = sorted(set(chosen) - set(numbers))
        if unknown:
            raise SceneError(f"{root}: {key}", f"cameras among {', '.join(map(str, numbers))}", f"{unknown[0]}")
    both = sorted(set(test) & set(drop))
    if both:
        raise SceneError(f"{root}: scene.drop_cameras", "no camera of scene.test_cameras", f"{both[0]} in both")
    kept = tuple(number for number in numbers if number not in drop)
    if not set(kept) - set(test):
        raise SceneError(
            root,
            "at least one camera to train on",
            f"{len(numbers)} cameras, of which {len(set(test))} held out and {len(set(drop))} dropped",
        )
    return kept


def require_equal(
    cameras: Sequence[tuple[Path, str]],
    what: str,
    values: Sequence[Any],
    show: Callable[[Any], str],
    relative: float = 0.0,
    absolute: float = 0.0,
) -> None:
    """SceneError for a camera whose value differs from that of most. cameras: of each its file and what drops it."""
    if not values:
        return
    # In a tie the first value counts: which of two cameras is wrong cannot be known.
    usual = Counter(values).most_common(1)[0][0]
    example = cameras[values.index(usual)][0]
    for (path, advice), value in zip(cameras, values, strict=True):
        if not np.isclose(value, usual, relative, absolute).all():
            raise SceneError(path, f"{show(usual)}{what} as {example.name}", f"{show(value)}: unsynchronised; {advice}")


def on_ticks(streams: Sequence[S], first_frame: int) -> tuple[S, ...]:
    """The streams with times since the first tick in use, whose number is `first_frame`; none is negative.

    Tick n is at n / rate. A time that is off by less than ROUNDING is that of its tick.
    """

    def late(stream: Stream) -> list[float]:
        off = [time * stream.rate - tick for time, tick in zip(stream.times, stream.ticks, strict=True)]
        return [frames if abs(frames) > ROUNDING else 0.0 for frames in off]

    lateness = [late(stream) for stream in streams]
    earliest = min(0.0, *(off[0] for off in lateness))
    return tuple(
        replace(
            stream,
            times=tuple(
                (tick - first_frame + frames - earliest) / stream.rate for tick, frames in zip(stream.ticks, off)
            ),
        )
        for stream, off in zip(streams, lateness)
    )


def drop_advice(number: int, drop: Collection[int]) -> str:
    """The setting that drops a camera besides those dropped already, for messages."""
    numbers = ",".join(map(str, sorted({*drop, number})))
    return f"scene.drop_cameras=[{numbers}] leaves camera {number} out"
