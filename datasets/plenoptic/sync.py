"""Checks that cameras are synchronised, from headers alone: one size, one frame rate, one start, enough frames."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from datasets.files.errors import SceneError
from datasets.plenoptic.decode import Stream

# Relative. Accepts 29.97 beside 30 frames a second: over 300 frames they differ by less than half a frame.
RATE_TOLERANCE = 1.5e-3
START_TOLERANCE = 0.5  # frames


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


def common_frames(streams: Sequence[Stream], first_frame: int, frames: int, drop: Collection[int]) -> int:
    """The number of frames from `first_frame` on, at most `frames`, that every camera has.

    Raises SceneError if sizes, rates or starts differ, or lengths where they matter. It names a camera that differs
    from the majority, and the setting that drops it.
    """

    def require_equal(
        what: str, values: list, show: Callable[[Any], str], relative: float = 0.0, absolute: float = 0.0
    ) -> None:
        # In a tie the first value counts: which of two cameras is wrong cannot be known.
        usual = Counter(values).most_common(1)[0][0]
        example = streams[values.index(usual)]
        for stream, value in zip(streams, values):
            if not np.isclose(value, usual, relative, absolute).all():
                raise SceneError(
                    stream.path,
                    f"{show(usual)}{what} as {example.path.name}",
                    f"{show(value)}: unsynchronised; {drop_advice(stream.number, drop)}",
                )

    require_equal(" pixels", [s.size for s in streams], lambda size: "{} x {}".format(*size))
    require_equal(" frames a second", [s.rate for s in streams], "{:.6g}".format, relative=RATE_TOLERANCE)
    require_equal(" frames", [s.start for s in streams], "a first frame at {:g}".format, absolute=START_TOLERANCE)
    if any(stream.count < first_frame + frames for stream in streams):
        require_equal(" frames", [s.count for s in streams], str)
    shortest = min(stream.count for stream in streams)
    if shortest <= first_frame:
        raise SceneError(
            f"{streams[0].path.parent}: scene.first_frame",
            f"below the {shortest} frames of each camera",
            f"{first_frame}",
        )
    return min(frames, shortest - first_frame)


def drop_advice(number: int, drop: Collection[int]) -> str:
    """The setting that drops a camera besides those dropped already, for messages."""
    numbers = ",".join(map(str, sorted({*drop, number})))
    return f"scene.drop_cameras=[{numbers}] leaves camera {number} out"
