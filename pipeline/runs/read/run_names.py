"""Writes and parses variant names such as `fast (batch=4)`; shortens names for use as file names."""

from __future__ import annotations

import hashlib
import re

_MAX_BYTES = 150  # of a file name; file systems allow 255, with the suffix and the prefix of a temporary file


def with_parts(name: str, parts: list[str]) -> str:
    """`fast`, [`batch=4`] -> `fast (batch=4)`. Parts already in brackets are kept."""
    name, before = parts_of(name)
    return f"{name} ({', '.join(before + parts)})" if before + parts else name


def parts_of(name: str) -> tuple[str, list[str]]:
    """The inverse of with_parts: `fast (batch=4)` -> `fast`, [`batch=4`]. A value may contain commas."""
    name, bracket, inside = name.partition(" (")
    return name, re.split(r", (?=[\w.]+=|\d+ more)", inside.removesuffix(")")) if bracket else []


def file_name(text: str) -> str:
    """`text` as a file name that any file system takes: other characters than letters, digits and _ - . become one _,
    and of what is too long the beginning and a hash are left."""
    text = re.sub(r"[^\w.-]+", "_", text)
    encoded = text.encode()
    if len(encoded) <= _MAX_BYTES:
        return text
    return f"{encoded[:_MAX_BYTES].decode(errors='ignore')}_{hashlib.blake2b(encoded, digest_size=4).hexdigest()}"
