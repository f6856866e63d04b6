"""Progress of long looks at the frames of a clip: a line every few seconds."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from typing import TypeVar

from datasets.source import Log

EVERY_S = 10.0  # seconds between lines; a look that is shorter says nothing

T = TypeVar("T")


def counted(items: Iterable[T], total: int, what: str, log: Log) -> Iterator[T]:
    """The items, with lines such as `walk.mp4: 400 of 2000 frames looked at, 40 s left`."""
    started = said = time.perf_counter()
    for number, item in enumerate(items, 1):
        yield item
        now = time.perf_counter()
        if now - said >= EVERY_S and number < total:
            said = now
            left = (now - started) / number * (total - number)
            log(f"{what}: {number} of {total} frames looked at, {left:.0f} s left")
