"""Keys of a configuration that an earlier version had, renamed and removed ones, or had not. Old run folders open; old
commands end with the new name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
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
    "train.film_overrides": "train.multi_view_overrides",
}
# Removed key, under its last name -> the value that changed nothing. No study showed a use for another.
REMOVED: dict[str, Any] = {
    "train.densify.time_split": True,  # a second copy of ablation.time_split
    "train.regularization.lifetime": 0.0,
    "train.regularization.color": 0.0,
}
# Added key -> the value that changes nothing, under which it is no part of the hashes of stages.
ADDED: dict[str, Any] = {
    "ablation.add_by_error": None,
    "scene.camera_path": "jumps",
    "train.regularization.flow": 0.0,
    "train.regularization.reference_views": 0.0,
    "train.regularization.rigid": 0.0,
    "train.regularization.rigid_every": 1,
    "train.regularization.rigid_neighbours": 20,
    "train.regularization.rigid_released": False,
    "train.regularization.still_lifetime": 0.0,
    "train.mse_weight": 0.0,
    "train.marginal_jitter": 0.0,
    "train.separate_tilt": False,
    "train.explicit_velocity": False,
    "train.lr.velocity": 1.0,
    "train.lr.mean_time_final": None,
    "train.densify.correct_clones": False,
    "train.densify.prune_hidden": 0.0,
    "train.densify.error_points": 0,
    "train.densify.error_points_share": 1.0,
    "train.densify.error_points_every": 500,
    "train.dropout": 0.0,
    "train.dropout_until": 1.0,
    "train.dropout_lifetime": 0.0,
    # Without effect but on driving logs, which no earlier version read.
    "train.depth.sfm": 0.0,
    "train.depth.lidar": 1.0,
    "train.depth.lidar_decay": 0.267,
    "train.depth.sky_inverse": 0.1,
    "train.depth.sky_opacity": 0.0,
    "train.cubemap_resolution": 128,
    "train.select_motion": 0.0,
    "train.multi_view_overrides": None,
    "train.clip_overrides": None,
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
    """A configuration, as nested dicts, under today's keys. Keys of no configuration stay as they are.

    Removed keys are dropped where they changed nothing, and stay otherwise: the schema then refuses them.
    """
    return _moved(tree, renamed_key, REMOVED)


def with_first_names(tree: dict[str, Any]) -> dict[str, Any]:
    """A configuration, as nested dicts, under the keys it had before any was renamed or added; for hashes that must
    last."""

    def first_name(key: str) -> str:
        for old, new in reversed(RENAMED.items()):
            if key == new or key.startswith(f"{new}."):
                key = old + key[len(new) :]
        return key

    merged = _moved({**tree}, str, ADDED)
    for key, value in REMOVED.items():
        group, name = key.rsplit(".", 1)
        _group(merged, group.split("."))[name] = value
    return _moved(merged, first_name)


def _moved(tree: dict[str, Any], rename: Callable[[str], str], without: Mapping[str, Any] = {}) -> dict[str, Any]:
    """The tree under other keys. without: leaves that are dropped where they have this value."""
    found: dict[str, Any] = {}
    for key, value in _leaves(tree, ""):
        new = rename(key)
        if new in without and value in (without[new], {}):  # an empty group changes nothing either
            continue
        *groups, last = new.split(".")
        try:
            _group(found, groups)[last] = value
        except TypeError:  # no configuration of ours: a value stands where a group is needed
            return tree
    return found


def _group(tree: dict[str, Any], names: list[str]) -> dict[str, Any]:
    """The nested dict at `names`, made if need be. TypeError where a value stands in the way."""
    for name in names:
        tree = tree.setdefault(name, {})
        if not isinstance(tree, dict):
            raise TypeError(name)
    return tree


def _leaves(tree: dict[str, Any], prefix: str) -> list[tuple[str, Any]]:
    """(dotted key, value) of everything but groups that hold something."""
    found = []
    for name, value in tree.items():
        key = f"{prefix}{name}"
        found += _leaves(value, f"{key}.") if isinstance(value, dict) and value else [(key, value)]
    return found
