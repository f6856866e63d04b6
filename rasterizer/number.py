"""Numbers as callers give them: of any kind that Python, numpy and torch have, or none at all."""

from __future__ import annotations

import math
import numbers

LONGEST_SHOWN = 200  # characters


def as_float(value: object) -> float:
    """A float; NaN for what is no number, so that the check for finite values refuses it. Text is no number."""
    if isinstance(value, (str, bytes, bytearray)):
        return math.nan
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError, RuntimeError):  # RuntimeError: a tensor of several
        return math.nan


def is_whole(value: object, low: int, high: int) -> bool:
    """Is it an integer, Python's or numpy's, in low..high?"""
    return isinstance(value, numbers.Integral) and low <= value <= high


def shown(value: object) -> str:
    """Its repr in one line of at most LONGEST_SHOWN characters, for messages."""
    try:
        line = " ".join(repr(value).split())
    except ValueError:  # an integer of more digits than Python writes
        return f"a {type(value).__name__} too long to show"
    return line if len(line) <= LONGEST_SHOWN else f"{line[:LONGEST_SHOWN]} …"
