"""The Pareto front of points with a cost and an error."""

from __future__ import annotations

from collections.abc import Sequence

EXACT = (0.0, 0.0)


def beats(one: tuple[float, float], other: tuple[float, float], margins: tuple[float, float] = EXACT) -> bool:
    """Whether `one` (cost, error) is at most as large as `other` in both, and smaller in at least one.

    margins: relative differences of cost and of error up to these count as equal.
    """
    less = [a < b * (1 - m) for a, b, m in zip(one, other, margins, strict=True)]
    no_more = [a <= b * (1 + m) for a, b, m in zip(one, other, margins, strict=True)]
    return all(no_more) and any(less)


def on_front(cost: Sequence[float], error: Sequence[float], margins: tuple[float, float] = EXACT) -> list[bool]:
    """For each point whether no other beats it. NaN (not measured) is never on the front and beats no point."""
    points = list(zip(cost, error, strict=True))
    return [c == c and e == e and not any(beats(other, (c, e), margins) for other in points) for c, e in points]
