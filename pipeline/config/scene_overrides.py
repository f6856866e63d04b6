"""Overrides by the kind of scene: keys of a schedule that have other values where nothing moves, or in films.

`train.static_overrides` holds those of static scenes, `train.film_overrides` those of moving scenes that several
cameras film. A run resolves its configuration once the scene is known (pipeline/model/scene_settings.py); its
config.yaml holds the result.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from omegaconf import OmegaConf

from pipeline.config.schema import Config

GROUPS = ("static_overrides", "film_overrides")  # keys of `train`


def with_overrides(cfg: Config, group: str | None) -> Config:
    """`cfg` for a scene of the kind of this group; None: of neither. Both groups are null then.

    Raises OmegaConf's errors and ValueError, as reading a configuration does.
    """
    chosen = getattr(cfg.train, group) if group else None
    differences = {**(chosen or {}), **dict.fromkeys(GROUPS)}
    merged = OmegaConf.merge(OmegaConf.create({"train": cfg.train}), {"train": differences})
    tree: Any = OmegaConf.to_object(merged)
    return replace(cfg, train=tree["train"])
