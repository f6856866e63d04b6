"""Names that differ in a number, written together as a shell does: `train/r_{000..149}.png`."""

from __future__ import annotations

import re
from collections.abc import Iterable

_LAST_NUMBER = re.compile(r"(.*?)(\d+)(\D*(?:\.[^./]*)?)", re.DOTALL)  # but of the ending: mp4 has none
_RANGE = re.compile(r"(.*)\{(\d+)\.\.(\d+)\}(.*)", re.DOTALL)


def ranges(names: Iterable[str]) -> dict[str, list[str]]:
    """Pattern -> its names, in their order; numbers of one width that follow each other are together. A name without a
    neighbour is its own pattern."""
    groups: list[list[str]] = []
    for name in names:
        if groups and _follows(groups[-1][-1], name):
            groups[-1].append(name)
        else:
            groups.append([name])
    return {_pattern(group): group for group in groups}


def expanded(pattern: str) -> list[str]:
    """The names of a pattern."""
    if not (found := _RANGE.fullmatch(pattern)):
        return [pattern]
    before, first, last, behind = found.groups()
    return [f"{before}{number:0{len(first)}}{behind}" for number in range(int(first), int(last) + 1)]


def _follows(name: str, following: str) -> bool:
    one, other = _LAST_NUMBER.fullmatch(name), _LAST_NUMBER.fullmatch(following)
    if not one or not other or (one[1], one[3], len(one[2])) != (other[1], other[3], len(other[2])):
        return False
    return int(other[2]) == int(one[2]) + 1


def _pattern(group: list[str]) -> str:
    first, last = (_LAST_NUMBER.fullmatch(name) for name in (group[0], group[-1]))
    return f"{first[1]}{{{first[2]}..{last[2]}}}{first[3]}" if first and last and len(group) > 1 else group[0]
