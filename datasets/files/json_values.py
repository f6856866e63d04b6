"""Values of a JSON file, checked one by one: each fault is a line that names the key."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from datasets.scene import SceneError


def get_key(container: dict, key: str, where: str | Path) -> Any:
    """container[key]; SceneError that lists what there is instead."""
    if key not in container:
        raise SceneError(where, f"the key {key}", f"only {', '.join(container) or 'nothing'}")
    return container[key]


def read_number(value: Any, where: str, largest: float | None = None) -> float:
    """A float, within ±largest; where that is None NaN and infinity too."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise SceneError(where, "a number", repr(value))
    try:
        number = float(value)
    except OverflowError:
        raise SceneError(where, "a number below 1.8e308", "a larger one") from None
    if largest is not None and not abs(number) <= largest:
        raise SceneError(where, f"a number within ±{largest:g}", f"{number}")
    return number
