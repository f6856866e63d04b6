"""Checked access to values of a JSON file; SceneError names the key."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from datasets.files.errors import SceneError, read_json


def read_object(file: Path, what: str = "an object", kind: str = "a file") -> dict[str, Any]:
    """The object that a JSON file holds. what, kind: expected of the content and of the file, for messages."""
    try:
        content = read_json(file, SceneError)
    except FileNotFoundError:
        raise SceneError(file, kind, "none") from None
    if not isinstance(content, dict):
        raise SceneError(file, what, type(content).__name__)
    return content


def get_key(container: dict, key: str, where: str | Path) -> Any:
    """container[key]; SceneError that lists the keys present if it is missing."""
    if key not in container:
        raise SceneError(where, f"the key {key}", f"only {', '.join(container) or 'nothing'}")
    return container[key]


def read_number(value: Any, where: str, largest: float | None = None) -> float:
    """`value` as a float within ±largest. With largest=None NaN and infinity are accepted too."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise SceneError(where, "a number", repr(value))
    try:
        number = float(value)
    except OverflowError:
        raise SceneError(where, "a number below 1.8e308", "a larger one") from None
    if largest is not None and not abs(number) <= largest:
        raise SceneError(where, f"a number within ±{largest:g}", f"{number}")
    return number
