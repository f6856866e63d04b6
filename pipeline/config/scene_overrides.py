"""Overrides by the kind of scene: keys of a schedule with other values where nothing moves, where several
cameras see each time, and for clips.

`train.static_overrides` holds those of static scenes, `train.multi_view_overrides` those of moving scenes with two
training views or more of each time on average, `train.clip_overrides` those of videos by one camera. A run resolves its
configuration once the scene is known (pipeline/model/scene_settings.py); its config.yaml holds the result. What the
command line gives counts on scenes of every kind.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

from hydra.core.override_parser.overrides_parser import OverridesParser
from omegaconf import DictConfig, OmegaConf

from pipeline.config.schema import Config

GROUPS = ("static_overrides", "multi_view_overrides", "clip_overrides")  # keys of `train`


def without_given(composed: DictConfig, arguments: Sequence[str]) -> DictConfig:
    """`composed` with those keys taken out of all groups that `arguments`, `key=value` of the command line, set."""
    given = [
        key.removeprefix("train.")
        for argument in OverridesParser.create().parse_overrides(list(arguments))
        for key in _keys_of(argument.key_or_group, argument.value())
        if key.startswith("train.")
    ]
    merged = composed.copy()
    tree: Any = OmegaConf.to_container(composed, resolve=False)
    for group in GROUPS:
        differences = tree["train"][group]
        for key in given:
            _remove(differences, key.split("."))
        OmegaConf.update(merged, f"train.{group}", differences, merge=False, force_add=True)
    return merged


def _keys_of(key: str, value: Any) -> Iterator[str]:
    """The dotted keys that `key=value` sets; a value in braces sets several."""
    if isinstance(value, Mapping):
        for name, inner in value.items():
            yield from _keys_of(f"{key}.{name}", inner)
    else:
        yield key


def _remove(tree: Any, path: list[str]) -> None:
    if isinstance(tree, dict) and path[0] in tree:
        if len(path) == 1:
            del tree[path[0]]
        else:
            _remove(tree[path[0]], path[1:])


def with_overrides(cfg: Config, group: str | None) -> Config:
    """`cfg` for a scene of the kind of this group; None: of none. All groups are null then.

    Raises OmegaConf's errors and ValueError, as reading a configuration does.
    """
    chosen = getattr(cfg.train, group) if group else None
    differences = {**(chosen or {}), **dict.fromkeys(GROUPS)}
    merged = OmegaConf.merge(OmegaConf.create({"train": cfg.train}), {"train": differences})
    tree: Any = OmegaConf.to_object(merged)
    return replace(cfg, train=tree["train"])
