"""Which of several compromises nobody would refuse: the Pareto front."""

from __future__ import annotations

from collections.abc import Sequence


def beats(one: tuple[float, float], other: tuple[float, float]) -> bool:
    """Whether `one` (cost, error) is at most as dear and at most as wrong as `other`, and one of the two truly less."""
    return one[0] <= other[0] and one[1] <= other[1] and one != other


def on_front(cost: Sequence[float], error: Sequence[float]) -> list[bool]:
    """For each point whether no other beats it. NaN, not measured, is never on the front and beats nobody."""
    points = list(zip(cost, error, strict=True))
    return [c == c and e == e and not any(beats(other, (c, e)) for other in points) for c, e in points]
