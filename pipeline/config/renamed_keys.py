"""Keys of a configuration that had another name in an earlier version: old run folders open, old commands are told."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

# Old key -> new key, dotted; whole groups too. Applied from top to bottom.
RENAMED = {
    "background": "background_model",
    "train.rate": "train.lr",
    "train.lr.hold": "train.lr.decay_start",
    "train.lr.environment": "train.lr.environment_map",
    "train.prior": "train.regularization",
    "train.densify.leave_out": "train.densify.prune_sensitivity",
    "train.densify.leave_out_every": "train.densify.prune_sensitivity_every",
    "train.trial": "train.select_time_colour",
    "train.environment_height": "train.envmap_height",
    "train.environment_until": "train.envmap_until",
    "train.where_still": "train.static_overrides",
}
_OVERRIDES = "train.static_overrides."  # holds keys of `train`


def renamed_key(key: str) -> str:
    """Today's name of a dotted key; the key itself where it was never renamed."""
    for old, new in RENAMED.items():
        if key == old or key.startswith(f"{old}."):
            key = new + key[len(old) :]
    if key.startswith(_OVERRIDES):
        key = _OVERRIDES + renamed_key("train." + key[len(_OVERRIDES) :]).removeprefix("train.")
    return key


def with_renamed_keys(tree: dict[str, Any]) -> dict[str, Any]:
    """A configuration, as nested dicts, under today's keys. Keys of no configuration stay as they are."""
    return _moved(tree, renamed_key)


def with_first_names(tree: dict[str, Any]) -> dict[str, Any]:
    """A configuration, as nested dicts, under the keys it had before any was renamed; for hashes that must last."""

    def first_name(key: str) -> str:
        for old, new in reversed(RENAMED.items()):
            if key == new or key.startswith(f"{new}."):
                key = old + key[len(new) :]
        return key

    return _moved(tree, first_name)


def _moved(tree: dict[str, Any], rename: Callable[[str], str]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in _leaves(tree, ""):
        *groups, last = rename(key).split(".")
        place = found
        for group in groups:
            below = place.setdefault(group, {})
            if not isinstance(below, dict):
                return tree  # no configuration of ours: two of its keys become one
            place = below
        place[last] = value
    return found


def _leaves(tree: dict[str, Any], prefix: str) -> list[tuple[str, Any]]:
    """(dotted key, value) of everything but groups that hold something."""
    found = []
    for name, value in tree.items():
        key = f"{prefix}{name}"
        found += _leaves(value, f"{key}.") if isinstance(value, dict) and value else [(key, value)]
    return found
