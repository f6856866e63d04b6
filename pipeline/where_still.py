"""What a schedule does otherwise where nothing moves: `train.where_still`, put in once the scene is known.

A moment that one camera saw is learnt by heart if nothing holds it back. Where nothing moves every view shows the same
moment, so that what holds back is only in the way there.
"""

from __future__ import annotations

from dataclasses import replace

from omegaconf import OmegaConf

from datasets.scene import Scene
from pipeline.config import Config
from pipeline.model import kind_of


def fitted(cfg: Config, scene: Scene) -> Config:
    """`cfg` for `scene`: with the differences if its model has no time, and none left to put in."""
    static = kind_of(scene, cfg).dims == 3
    return with_differences(cfg) if static else replace(cfg, train=replace(cfg.train, where_still=None))


def with_differences(cfg: Config) -> Config:
    """`cfg` where nothing moves. Raises OmegaConf's errors and ValueError, as reading a configuration does."""
    differences = {**(cfg.train.where_still or {}), "where_still": None}
    merged = OmegaConf.merge(OmegaConf.create({"train": cfg.train}), {"train": differences})
    return replace(cfg, train=OmegaConf.to_object(merged)["train"])
