"""Ordinal numbers in the names of splits: "every 8th frame"."""

from __future__ import annotations


def ordinal(number: int) -> str:
    """ "2nd", "3rd", "8th"."""
    ending = {1: "st", 2: "nd", 3: "rd"}.get(number % 10, "th") if number % 100 not in (11, 12, 13) else "th"
    return f"{number}{ending}"
