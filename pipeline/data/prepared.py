"""Prepared: what a run starts from, its scene and its initial points."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from datasets.canonical import Canonical
from datasets.scene import Scene
from datasets.settings import SceneConfig
from pipeline.data.sfm.reconstruction import Reconstruction


@dataclass(frozen=True)
class Prepared:
    """A scene and its initial points, in canonical coordinates."""

    scene: Scene
    cloud: Reconstruction | None  # None: random points, or those of LiDAR
    sfm_folder: Path | None  # cache folder of the cloud, with its summary and plot
    canonical: Canonical = Canonical()  # transform from the files' units
    poses_estimated: bool = False  # of every frame: the user's own videos by cameras that move
    settings: SceneConfig | None = None  # as the data were read: the layout and the split found out; None: as given
    points: str = "random"  # where the initial points come from: given (with the files), sfm, lidar or random
