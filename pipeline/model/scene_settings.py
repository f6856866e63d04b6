"""Settings that depend on the scene: the static overrides of the schedule, and `scene.background=auto`."""

from __future__ import annotations

from dataclasses import replace

from datasets.scene import Scene
from pipeline.config.schema import Config
from pipeline.config.static_overrides import with_static_overrides, without_static_overrides
from pipeline.model.model import kind_of


def resolved(cfg: Config, scene: Scene) -> Config:
    """`cfg` with the settings that depend on `scene` filled in. Idempotent."""
    static = kind_of(scene, cfg).motion == "static"
    cfg = with_static_overrides(cfg) if static else without_static_overrides(cfg)
    return replace(cfg, scene=replace(cfg.scene, background=list(scene.background)))
