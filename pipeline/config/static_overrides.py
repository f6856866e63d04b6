"""Static overrides: keys of a schedule that have other values for a scene in which nothing moves.

`train.static_overrides` holds them. A run resolves its configuration once the scene is known
(pipeline/model/scene_settings.py); its config.yaml holds the result.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from omegaconf import OmegaConf

from pipeline.config.schema import Config


def with_static_overrides(cfg: Config) -> Config:
    """`cfg` for a static scene. Raises OmegaConf's errors and ValueError, as reading a configuration does."""
    differences = {**(cfg.train.static_overrides or {}), "static_overrides": None}
    merged = OmegaConf.merge(OmegaConf.create({"train": cfg.train}), {"train": differences})
    tree: Any = OmegaConf.to_object(merged)
    return replace(cfg, train=tree["train"])


def without_static_overrides(cfg: Config) -> Config:
    """`cfg` for a scene in which something moves."""
    return replace(cfg, train=replace(cfg.train, static_overrides=None))
