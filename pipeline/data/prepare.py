"""Prepares the input of a run: reads the scene, runs structure from motion where needed, and normalises both.

Data are read in the units of their files (sources/). The result is in canonical coordinates (datasets/canonical.py), as
is everything computed from it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from datasets import SceneKind, scene_kind, with_reader
from datasets.canonical import canonical_of, canonicalise
from datasets.scene import ScenePoints
from pipeline.config.schema import Config
from pipeline.data.prepared import Prepared
from pipeline.data.sources.clips import from_clip, from_clips
from pipeline.data.sources.drive import from_drive
from pipeline.data.sources.photographs import from_photographs
from pipeline.data.sources.reconstruct import transformed
from pipeline.data.sources.videos import from_posed_videos, from_videos

Source = Callable[[Config, Callable[[str], None]], Prepared]

SOURCES: dict[SceneKind, Source] = {
    "photographs": from_photographs,
    "posed_videos": from_posed_videos,
    "videos": from_videos,
    "clip": from_clip,
    "clips": from_clips,
    "drive": from_drive,
}


def prepare(cfg: Config, log: Callable[[str], None]) -> Prepared:
    """The scene of a config and its initial points. Structure from motion runs if its result is not in the cache.

    Normalisation comes last, because it depends on poses that structure from motion may estimate or refine. Raises
    ValueError for invalid data or settings.
    """
    cfg = replace(cfg, scene=with_reader(cfg.scene, log))
    kind = scene_kind(cfg.scene)
    _check(cfg, kind)
    data = SOURCES[kind](cfg, log)
    transform = canonical_of(data.scene)
    if not transform.is_identity:
        log(f"normalised: {transform}")
        cloud = None if data.cloud is None else transformed(data.cloud, transform)
        data = replace(data, scene=canonicalise(data.scene, transform), cloud=cloud, canonical=transform)
    if data.cloud is None:
        return data
    return replace(data, scene=replace(data.scene, points=ScenePoints(data.cloud.points, data.cloud.colors)))


def _check(cfg: Config, kind: SceneKind) -> None:
    """ValueError for settings of several cameras' videos, or of driving logs, where there are none."""
    if cfg.init.source == "lidar" and kind != "drive":
        raise ValueError("init.source: expected auto, random or sfm for a scene without LiDAR, found lidar")
    several = kind in ("posed_videos", "videos", "clips")
    if cfg.scene.color_correction is True and (not several or cfg.init.source == "random"):
        why = "random points" if several else "a scene that is not several videos"
        raise ValueError(f"scene.color_correction: expected auto or false for {why}, found true")
    if cfg.scene.moving_cameras is True and kind != "clips":
        raise ValueError("scene.moving_cameras: expected auto or false for a scene without several videos, found true")
