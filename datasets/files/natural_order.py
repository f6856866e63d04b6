"""The order in which a reader expects names with numbers, and the numbers that count frames."""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

GAPS = 20.0  # × the span of evenly spaced frames: numbers that span more are no times, but serial numbers, say


def natural_order(name: str) -> tuple[list[tuple[int, int | str]], str]:
    """A sort key that compares runs of digits by value, 2 before 10, and takes no notice of upper case."""
    parts = [part for part in re.split(r"(\d+)", name) if part]
    return [(0, int(part)) if part.isdecimal() else (1, part.lower()) for part in parts], name


def last_number(stem: str) -> float | None:
    """12 of "frame_012"; None without digits. Of a name that ends in seconds these: 0.25 of "t_0.25",
    1305031102.175304, and 1678901234.133 of "1678901234_133000000", which counts nanoseconds."""
    if seconds := re.search(r"(?:^|[_-])(\d{9,10})_(\d{9})$", stem):
        return float(f"{seconds[1]}.{seconds[2]}")
    if decimal := re.search(r"(?:^|[_-])(\d+\.\d+)$", stem):
        return float(decimal[1])
    found = re.findall(r"\d+", stem)
    return float(found[-1]) if found else None


def end_numbers(names: Sequence[str]) -> list[int]:
    """Numbers of cameras: those that their names end in, if all do and differ, else their places, from 0."""
    stated = [int(end[0]) for name in names if (end := re.search(r"[0-9]+$", name))]
    return stated if len(set(stated)) == len(names) else list(range(len(names)))


def starts_again(stems: Sequence[str]) -> bool:
    """Whether the last number of names that differ in numbers alone falls where one before it rises: a fraction of a
    second, as the 07 of IMG_101531_07 after IMG_101530_55."""
    if len({re.sub(r"\d+", "", stem) for stem in stems}) > 1:
        return False
    numbers = sorted([int(digits) for digits in re.findall(r"\d+", stem)] for stem in stems)
    if not numbers[0] or len({tuple(own[:-1]) for own in numbers}) < 2:
        return False
    in_seconds = any(last_number(stem) != int(re.findall(r"\d+", stem)[-1]) for stem in stems)  # with decimals
    return not in_seconds and any(one[-1] > other[-1] for one, other in pairwise(numbers))


def about_even(numbers: Sequence[float | None]) -> bool:
    """Whether the numbers of names may count frames: all are there, two differ, and gaps are not most of the span."""
    different = np.unique(np.array(numbers, dtype=np.float64))  # None becomes NaN
    if len(different) < 2 or not np.isfinite(different).all():
        return False
    steps = np.diff(different)
    return bool(steps.sum() <= GAPS * len(steps) * np.median(steps))
