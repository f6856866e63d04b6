"""What the schemas share: the check of a value's range, and names that several of them know."""

from __future__ import annotations

from typing import Any

BACKGROUNDS = ("none", "sphere", "envmap")


def require(condition: bool, key: str, expected: str, found: Any) -> None:
    """Raises ValueError, one line, unless the condition holds."""
    if not condition:
        raise ValueError(f"{key}: expected {expected}, found {found!r}")
