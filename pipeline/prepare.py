"""What a run works on: the scene, and where structure from motion is called for, its cameras and points.

Three kinds of footage come together here. Photographs of one moving camera bring their poses and start from random
points. Several posed cameras (Plenoptic Video) have points triangulated on their first frames. Videos without poses
have both found for them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from datasets import Scene, View, load_footage, load_scene
from pipeline.config import Config
from pipeline.sfm.photograph import Photograph, Reconstruction
from rasterizer.camera import Camera

if TYPE_CHECKING:  # it brings a video decoder, which other scenes do without
    from datasets.plenoptic import Footage

# Without bounds a scene's unit is so much of the depth that all but a twentieth of its points lie beyond, as
# Plenoptic Video's is of its near bound (datasets/plenoptic).
UNIT_OF_NEAR, NEAR_QUANTILE = 0.75, 0.05


@dataclass(frozen=True)
class Prepared:
    """A scene ready to be trained on."""

    scene: Scene
    cloud: Reconstruction | None  # None: random points
    sfm_folder: Path | None  # where the cloud is kept, with its summary and its picture


def prepare(cfg: Config, say: Callable[[str], None]) -> Prepared:
    """Read the scene, run structure from motion where needed (or take its kept result). Raises ValueError."""
    if cfg.scene.reader == "video":
        return _from_videos(cfg, load_footage(cfg.scene, threads=cfg.threads, say=say), say)
    scene = load_scene(cfg.scene, threads=cfg.threads, say=say)
    if not wants_points(cfg, scene):
        return Prepared(scene, None, None)
    photographs = first_photographs(scene)
    cloud, folder = _reconstruct(cfg, photographs, scene.unit, scene.source, say)
    if cloud.poses == "refined":
        scene = with_cameras(scene, {name: lens.camera for name, lens in cloud.lenses.items()})
    return Prepared(scene, cloud, folder)


def wants_points(cfg: Config, scene: Scene) -> bool:
    """Do points come from structure from motion? By themselves for scenes that several cameras filmed."""
    return cfg.init.source == "sfm" or (cfg.init.source == "auto" and scene.frame_rate is not None)


def first_photographs(scene: Scene) -> list[Photograph]:
    """The training views of the first moment, as photographs named after their cameras."""
    first = min(view.time for view in scene.train)
    return [Photograph(camera_name(view), np.asarray(view.image), view.camera)
            for view in scene.train if view.time == first]


def camera_name(view: View) -> str:
    """"cam01" of "train/cam01_0000"; of a photograph, its whole name without the split."""
    stem = view.name.rpartition("/")[2]
    camera, underscore, frame = stem.rpartition("_")
    return camera if underscore and frame.isdigit() else stem


def with_cameras(scene: Scene, cameras: dict[str, Camera]) -> Scene:
    """The scene with other cameras for the views of those named."""
    def moved(views: tuple[View, ...]) -> tuple[View, ...]:
        return tuple(replace(view, camera=cameras.get(camera_name(view), view.camera)) for view in views)
    return replace(scene, train=moved(scene.train), test=moved(scene.test))


def _from_videos(cfg: Config, footage: Footage, say: Callable[[str], None]) -> Prepared:
    """Poses and points of a folder of videos. Points are as photographed: the rest of a lens is taken out of the
    frames when they are decoded."""
    from datasets.plenoptic import Undistortion

    photographs = [Photograph(name, image, held_out=name in footage.held_out)
                   for name, image in zip(footage.names, footage.first_images())]
    cloud, folder = _reconstruct(cfg, photographs, 1.0, footage.source, say)
    trained = [lens.camera for name, lens in cloud.lenses.items() if name not in footage.held_out]
    scene = footage.to_scene({name: lens.camera for name, lens in cloud.lenses.items()},
                             {name: Undistortion.of(lens.camera, lens.radial) for name, lens in cloud.lenses.items()},
                             unit=UNIT_OF_NEAR * near_depth(cloud.points, trained))
    return Prepared(scene, cloud if cfg.init.source != "random" else None, folder)


def near_depth(points: np.ndarray, cameras: list[Camera]) -> float:
    """The depth that all but NEAR_QUANTILE of the points (N, 3) lie beyond, over all cameras, world units."""
    depths = np.concatenate([points @ c.world_to_cam[2, :3] + c.world_to_cam[2, 3] for c in cameras])
    return float(np.quantile(depths[depths > 0], NEAR_QUANTILE))


def _reconstruct(cfg: Config, photographs: list[Photograph], unit: float, source: Path, say: Callable[[str], None]
                 ) -> tuple[Reconstruction, Path]:
    from pipeline.sfm.store import reconstruct_once  # what scenes with random points do without

    say(f"sfm: {len(photographs)} cameras, first frames of {source}")
    cloud, folder = reconstruct_once(photographs, cfg.init, unit, source, Path(cfg.scene.cache))
    found = cloud.summary()
    say(f"sfm: {found['points']} points, mean error {found['mean_error_px']:.2f} px, in "
        f"{found['mean_track_length']:.1f} images each; kept in {folder}")
    return cloud, folder
