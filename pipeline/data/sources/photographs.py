"""Photographs with poses, by one moving camera or of a static scene."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from datasets import Scene, load_scene
from pipeline.config.schema import Config
from pipeline.data.prepared import Prepared
from pipeline.data.sfm.photograph import Reconstruction


def from_photographs(cfg: Config, log: Callable[[str], None]) -> Prepared:
    """The scene, and the points that came with it. ValueError for init.source=sfm."""
    if cfg.init.source == "sfm":
        raise ValueError(
            f"init.source: expected auto or random for {cfg.scene.name}, which has one camera per time, found sfm"
        )
    scene = load_scene(cfg.scene, threads=cfg.threads, log=log)
    return Prepared(replace(scene, points=None), _given_points(cfg, scene, log), None)


def _given_points(cfg: Config, scene: Scene, log: Callable[[str], None]) -> Reconstruction | None:
    """The points that came with the data; None without any, where they are too few, and for init.source=random."""
    if scene.points is None or cfg.init.source == "random":
        return None
    count = len(scene.points.positions)
    if count < cfg.init.min_points:
        log(f"the folder's {count} points are fewer than init.min_points={cfg.init.min_points}: random points instead")
        return None
    unknown = np.zeros(count)
    return Reconstruction(
        scene.points.positions, scene.points.colors, unknown, unknown.astype(int), {}, "known", len(scene.train), 0.0
    )
