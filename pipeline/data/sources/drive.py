"""Driving logs: cameras on a car, with LiDAR or without."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from datasets import Scene, load_scene
from pipeline.config.schema import Config
from pipeline.data.prepared import Prepared
from pipeline.data.sfm.photograph import Photograph
from pipeline.data.sources.reconstruct import reconstruct
from pipeline.data.training_views import evenly_spaced

SFM_IMAGES = 60  # evenly spaced, that structure from motion takes


def from_drive(cfg: Config, log: Callable[[str], None]) -> Prepared:
    """The log and its points."""
    return with_points(cfg, load_scene(cfg.scene, threads=cfg.threads, log=log), log)


def with_points(cfg: Config, scene: Scene, log: Callable[[str], None]) -> Prepared:
    """With LiDAR the points are taken from its sweeps later (model/initialise.py). Without, or where `init.source` says
    so, structure from motion finds points with the log's poses. ValueError for settings that do not fit the log."""
    if cfg.init.source == "lidar" and not scene.sweeps:
        raise ValueError(
            f"init.source: expected auto, sfm or random for {scene.source}, a log without LiDAR, found lidar"
        )
    from_lidar = scene.sweeps and cfg.init.source in ("auto", "lidar")
    if from_lidar and cfg.scene.background_model == "sphere":
        raise ValueError(
            f"scene.background_model: expected cubemap, envmap or none for {scene.source}, whose points are LiDAR's, "
            "found sphere; init.source=sfm or random allows it"
        )
    if from_lidar or cfg.init.source == "random":
        return Prepared(scene, None, None)
    chosen = evenly_spaced(len(scene.train), SFM_IMAGES)
    photographs = [
        Photograph(view.name.replace("/", "_"), np.asarray(view.image), view.camera)
        for view in (scene.train[index] for index in chosen)
    ]
    cloud, folder = reconstruct(cfg, photographs, scene.unit, scene.source, log)
    return Prepared(scene, cloud, folder)
