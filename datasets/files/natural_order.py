"""The order in which a reader expects names with numbers, and the number that counts frames."""

from __future__ import annotations

import re


def natural_order(name: str) -> tuple[list[tuple[int, int | str]], str]:
    """A sort key that compares runs of digits by value, 2 before 10, and takes no notice of upper case."""
    parts = [part for part in re.split(r"(\d+)", name) if part]
    return [(0, int(part)) if part.isdecimal() else (1, part.lower()) for part in parts], name


def last_number(stem: str) -> float | None:
    """12 of "frame_012"; the whole of a name that is seconds, as 1305031102.175304; None without digits."""
    if re.fullmatch(r"\d+\.\d+", stem):
        return float(stem)
    found = re.findall(r"\d+", stem)
    return float(found[-1]) if found else None
