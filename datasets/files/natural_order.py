"""The order in which a reader expects names with numbers."""

from __future__ import annotations

import re


def natural_order(name: str) -> tuple[list[tuple[int, int | str]], str]:
    """A sort key that compares runs of digits by value, 2 before 10, and takes no notice of upper case."""
    parts = [part for part in re.split(r"(\d+)", name) if part]
    return [(0, int(part)) if part.isdecimal() else (1, part.lower()) for part in parts], name
