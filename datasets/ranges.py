"""Ranges of values: what the schemas allow, and how a message names it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Range:
    """A set of values and its name in messages."""

    expected: str
    holds: Callable[[Any], bool]

    def but(self, meaning: str) -> Range:
        """The same range with the meaning of a special value, for the message: at_least(0).but("0: never")."""
        return Range(f"{self.expected} ({meaning})", self.holds)


def positive_count(low: int = 1) -> Range:
    """Whole numbers of at least `low`."""
    return Range(f"at least {low}", lambda value: value >= low)


def at_least(low: float) -> Range:
    return Range(f">= {low}", lambda value: value >= low)


def above(low: float) -> Range:
    return Range(f"> {low}", lambda value: value > low)


def between(text: str, low: float, high: float) -> Range:
    """text: the interval as it is written, with round brackets where an end is not part of it: "(0, 1]"."""
    return Range(
        f"in {text}",
        lambda value: (
            (value > low if text[0] == "(" else value >= low) and (value < high if text[-1] == ")" else value <= high)
        ),
    )


def one_of(*choices: str) -> Range:
    *others, last = choices
    text = f"{', '.join(others)} or {last}"
    return Range(text, lambda value: value in choices)


def some_of(*choices: str) -> Range:
    """Lists of any of these."""
    return Range(f"some of {', '.join(choices)}", lambda values: set(values) <= set(choices))


def check(group: str, config: Any, ranges: dict[str, Range]) -> None:
    """ValueError, one line, for the first field of `config` outside its range. None, of an optional field, passes.

    group: the dotted key of `config`, for the message.
    """
    for name, allowed in ranges.items():
        value = getattr(config, name)
        require(value is None or allowed.holds(value), f"{group}.{name}", allowed.expected, value)


def require(condition: bool, key: str, expected: str, found: Any) -> None:
    """Raises a ValueError of one line if the condition is false."""
    if not condition:
        raise ValueError(f"{key}: expected {expected}, found {found!r}")
