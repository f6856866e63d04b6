"""Do the cameras belong together: one size, one rate, one start, enough frames each? Seen from headers alone."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Hashable, Sequence
from pathlib import Path

from datasets.plenoptic.decode import Stream
from datasets.scene import SceneError

# Relative. 29.97 and 30 a second pass for one rate: over the 300 frames of a scene they part by less than half a frame.
RATE_TOLERANCE = 1.5e-3
START_TOLERANCE = 0.5  # frames


def choose(numbers: Sequence[int], root: Path, test: Collection[int], drop: Collection[int]) -> tuple[int, ...]:
    """The cameras' `numbers` less those dropped, if each number asked for is among them and some are left to train."""
    for number in numbers:
        if numbers.count(number) > 1:
            raise SceneError(root, "one name a camera", f"several with number {number}")
    for key, wanted in (("scene.test_cameras", test), ("scene.drop_cameras", drop)):
        unknown = sorted(set(wanted) - set(numbers))
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
    """How many frames from `first_frame` on, at most `frames`, every camera has.

    Raises SceneError, naming the camera that differs from most and how to leave it out, for different sizes, rates or
    starts, and for different lengths where they matter.
    """

    def all_alike(
        what: str,
        value: Callable[[Stream], Hashable],
        alike: Callable[[Hashable, Hashable], bool],
        show: Callable[[Hashable], str],
    ) -> None:
        # Of a tie the first: of two cameras nobody can say which one is right.
        usual = Counter(value(stream) for stream in streams).most_common(1)[0][0]
        model = next(stream for stream in streams if value(stream) == usual)
        for stream in streams:
            if not alike(value(stream), usual):
                raise SceneError(
                    stream.path,
                    f"{show(usual)}{what} as {model.path.name}",
                    f"{show(value(stream))}: unsynchronised; {drop_advice(stream.number, drop)}",
                )

    all_alike(" pixels", lambda s: s.size, lambda a, b: a == b, lambda size: "{} x {}".format(*size))
    all_alike(" frames a second", lambda s: s.rate, lambda a, b: abs(a - b) <= RATE_TOLERANCE * b, lambda r: f"{r:.6g}")
    all_alike(
        " frames",
        lambda s: s.start,
        lambda a, b: abs(a - b) <= START_TOLERANCE,
        lambda start: f"a first frame at {start:g}",
    )
    if any(stream.count < first_frame + frames for stream in streams):
        all_alike(" frames", lambda s: s.count, lambda a, b: a == b, str)
    shortest = min(stream.count for stream in streams)
    if shortest <= first_frame:
        raise SceneError(
            f"{streams[0].path.parent}: scene.first_frame",
            f"below the {shortest} frames of each camera",
            f"{first_frame}",
        )
    return min(frames, shortest - first_frame)


def drop_advice(number: int, drop: Collection[int]) -> str:
    """How to do without a camera, on the command line; what is dropped already stays so."""
    numbers = ",".join(map(str, sorted({*drop, number})))
    return f"scene.drop_cameras=[{numbers}] leaves camera {number} out"
