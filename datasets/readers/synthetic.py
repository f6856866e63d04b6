"""Scenes that datasets/synthetic makes, read back by the readers of the layouts that they are written in."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from datasets.readers import dnerf
from datasets.scene import PLAYBACK_RATE, Scene
from datasets.settings import SceneConfig
from datasets.source import Log, PosedImages, Source


def open_source(cfg: SceneConfig, threads: int, log: Log) -> Source:
    """Photographs are made when they are read, videos and logs at once."""
    from datasets.synthetic import DRIVEN, FILMED

    name = cfg.name.rpartition("/")[2]  # "wheel" of "synthetic/wheel"
    if name in FILMED:
        from datasets.plenoptic.filmed import videos_config
        from datasets.readers.plenoptic import open_folder

        cfg = videos_config(cfg)  # refused before they are made
        return open_folder(_made(name, cfg, "cameras", log), cfg, threads, log)
    if name in DRIVEN:
        from datasets.readers.waymo import open_waymo
        from datasets.urban.assemble import DriveSource

        return DriveSource(cfg, open_waymo(_made(name, cfg, "frames", log)), log)
    return PosedImages(cfg, lambda: _photographed(name, cfg, log), points="random")


def _photographed(name: str, cfg: SceneConfig, log: Log) -> Scene:
    scene = dnerf.read(_made(name, cfg, "cameras", log), cfg, log)
    filmed = cfg.camera_path == "arc" and scene.capture == "monocular"
    return replace(scene, capture="clip", playback_rate=PLAYBACK_RATE) if filmed else scene


def _made(name: str, cfg: SceneConfig, what: str, log: Log) -> Path:
    """The folder of the scene, which is rendered first unless it is in the cache."""
    from datasets.synthetic import make_scene

    keys = ("seed", "size", "train_views", "test_views", "cameras", "frames", "camera_path")
    return make_scene(
        name,
        cfg.cache,
        progress=lambda done, total: log(f"{cfg.name}: {done} of {total} {what} rendered"),
        **{key: getattr(cfg, key) for key in keys},
    )
