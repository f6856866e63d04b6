"""How a name and what was changed under it are written together: `fast`, [`batch=4`] <-> `fast (batch=4)`; and as the
name of a file."""

from __future__ import annotations

import hashlib
import re

_LONGEST = 150  # bytes of a file's name; file systems hold 255, its suffix and a temporary name's prefix among them


def with_parts(name: str, parts: list[str]) -> str:
    """`fast`, [`batch=4`] -> `fast (batch=4)`; what stands in brackets already stays there."""
    name, before = parts_of(name)
    return f"{name} ({', '.join(before + parts)})" if before + parts else name


def parts_of(name: str) -> tuple[str, list[str]]:
    """What with_parts put together; a value may hold commas."""
    name, bracket, inside = name.partition(" (")
    return name, re.split(r", (?=[\w.]+=|\d+ more)", inside.removesuffix(")")) if bracket else []


def file_name(text: str) -> str:
    """`text`, or where that is too long for a file's name its beginning and a hash of it."""
    encoded = text.encode()
    if len(encoded) <= _LONGEST:
        return text
    return f"{encoded[:_LONGEST].decode(errors='ignore')}_{hashlib.blake2b(encoded, digest_size=4).hexdigest()}"
