"""The configuration that a run computes with: what was asked for, with everything filled in that the data decide.

Two keys wait for the scene: `train.where_still` (what the schedule does otherwise where nothing moves) and
`scene.background=auto`. A run folder's config.yaml holds the result.
"""

from __future__ import annotations

from dataclasses import replace

from omegaconf import OmegaConf

from datasets.scene import Scene
from pipeline.config.schema import Config
from pipeline.model.model import kind_of


def resolved(cfg: Config, scene: Scene) -> Config:
    """`cfg` for `scene`. Resolving twice is resolving once."""
    static = kind_of(scene, cfg).dims == 3
    cfg = with_static_differences(cfg) if static else replace(cfg, train=replace(cfg.train, where_still=None))
    return replace(cfg, scene=replace(cfg.scene, background=list(scene.background)))


def with_static_differences(cfg: Config) -> Config:
    """`cfg` where nothing moves. Raises OmegaConf's errors and ValueError, as reading a configuration does."""
    differences = {**(cfg.train.where_still or {}), "where_still": None}
    merged = OmegaConf.merge(OmegaConf.create({"train": cfg.train}), {"train": differences})
    return replace(cfg, train=OmegaConf.to_object(merged)["train"])
