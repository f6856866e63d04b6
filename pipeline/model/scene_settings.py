"""Settings that depend on the scene: the overrides of the schedule by kind of scene, and `scene.background=auto`."""

from __future__ import annotations

from dataclasses import replace

from datasets.scene import Scene
from pipeline.config.scene_overrides import with_overrides
from pipeline.config.schema import Config
from pipeline.model.model import kind_of


def resolved(cfg: Config, scene: Scene) -> Config:
    """`cfg` with the settings that depend on `scene` filled in. Idempotent.

    The static overrides stay while `select_motion` has still to decide whether the model is static.
    """
    group, static = overrides_for(scene, cfg), cfg.train.static_overrides
    cfg = with_overrides(cfg, group)
    if group != "static_overrides" and cfg.train.select_motion > 0 and cfg.ablation.static is None:
        cfg = replace(cfg, train=replace(cfg.train, static_overrides=static))
    return replace(cfg, scene=replace(cfg.scene, background=list(scene.background)))


def overrides_for(scene: Scene, cfg: Config) -> str | None:
    """Which of the schedule's overrides apply to a model of `scene`; None: none."""
    if kind_of(scene, cfg).motion == "static":
        return "static_overrides"
    if scene.several_cameras:
        return "multi_view_overrides"
    return "clip_overrides" if scene.capture == "clip" else None
