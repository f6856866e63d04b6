"""How a name and what was changed under it are written together: `fast`, [`batch=4`] <-> `fast (batch=4)`."""

from __future__ import annotations

import re


def with_parts(name: str, parts: list[str]) -> str:
    """`fast`, [`batch=4`] -> `fast (batch=4)`; what stands in brackets already stays there."""
    name, before = parts_of(name)
    return f"{name} ({', '.join(before + parts)})" if before + parts else name


def parts_of(name: str) -> tuple[str, list[str]]:
    """What with_parts put together; a value may hold commas."""
    name, bracket, inside = name.partition(" (")
    return name, re.split(r", (?=[\w.]+=|\d+ more)", inside.removesuffix(")")) if bracket else []
