"""What a run works on: the scene, and where structure from motion is called for, its cameras and points.

Three kinds of footage come together here. Photographs of one moving camera bring their poses and start from random
points. Several posed cameras (Plenoptic Video) have points triangulated on their first frames. Videos without poses
have both found for them. All of this is in the units of the files; what comes out is in canonical coordinates
(datasets/canonical.py), and so is everything that a run makes of it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from datasets import Scene, is_filmed, load_footage, load_posed, load_scene
from datasets.canonical import Canonical, canonical_of, canonical_space, canonicalise
from pipeline.config.schema import Config
from pipeline.data.sfm.photograph import Photograph, Reconstruction
from rasterizer.camera import Camera

if TYPE_CHECKING:  # it brings a video decoder, which other scenes do without
    from datasets.plenoptic import Footage, Posed

# Without bounds a scene's unit is so much of the depth that all but a twentieth of its points lie beyond, as
# Plenoptic Video's is of its near bound (datasets/plenoptic).
UNIT_OF_NEAR, NEAR_QUANTILE = 0.75, 0.05


@dataclass(frozen=True)
class Prepared:
    """A scene ready to be trained on; it and its points are in canonical coordinates."""

    scene: Scene
    cloud: Reconstruction | None  # None: random points
    sfm_folder: Path | None  # where the cloud is kept, with its summary and its picture
    canonical: Canonical = Canonical()  # how the files' units became canonical ones


def prepare(cfg: Config, log: Callable[[str], None]) -> Prepared:
    """Read the scene, run structure from motion where needed (or take its kept result), normalise both.

    Normalised last, because only structure from motion finds or refines some poses. Raises ValueError.
    """
    data = _in_own_units(cfg, log)
    frame = canonical_of(data.scene)
    if frame.is_identity:
        return data
    log(f"normalised: {frame}")
    cloud = None if data.cloud is None else _moved(data.cloud, frame)
    return replace(data, scene=canonicalise(data.scene, frame), cloud=cloud, canonical=frame)


def _in_own_units(cfg: Config, log: Callable[[str], None]) -> Prepared:
    """What the files hold and structure from motion finds, not normalised yet."""
    if cfg.scene.reader == "video":
        return _from_videos(cfg, load_footage(cfg.scene, threads=cfg.threads, log=log), log)
    if is_filmed(cfg.scene) and cfg.init.source != "random":
        return _from_posed(cfg, load_posed(cfg.scene, threads=cfg.threads, log=log), log)
    if cfg.init.source == "sfm":
        raise ValueError(
            f"init.source: expected auto or random for {cfg.scene.name}, which one camera saw at a time, found sfm"
        )
    return Prepared(load_scene(cfg.scene, threads=cfg.threads, log=log), None, None)


def _from_posed(cfg: Config, posed: Posed, log: Callable[[str], None]) -> Prepared:
    """Points seen by the training cameras: from whole frames, before the scene's own, smaller ones are decoded."""
    cloud, folder = _reconstruct(cfg, training_photographs(posed), posed.unit, posed.footage.source, log)
    if cloud.poses == "refined":
        found = {name: lens.camera for name, lens in cloud.lenses.items()}
        posed = replace(posed, cameras={**posed.cameras, **found})
    return Prepared(posed.to_scene(), cloud, folder)


def training_photographs(posed: Posed) -> list[Photograph]:
    """The first frames of the cameras that are not held out, whole."""
    return [
        Photograph(name, image, posed.cameras[name])
        for name, image in posed.first_images().items()
        if name not in posed.footage.held_out
    ]


def _from_videos(cfg: Config, footage: Footage, log: Callable[[str], None]) -> Prepared:
    """Poses and points of a folder of videos. Points are as photographed: the rest of a lens is taken out of the
    frames when they are decoded."""
    from datasets.plenoptic import Undistortion

    photographs = [
        Photograph(name, image, held_out=name in footage.held_out) for name, image in footage.first_images().items()
    ]
    cloud, folder = _reconstruct(cfg, photographs, 1.0, footage.source, log)
    trained = [lens.camera for name, lens in cloud.lenses.items() if name not in footage.held_out]
    scene = footage.to_scene(
        {name: lens.camera for name, lens in cloud.lenses.items()},
        {name: Undistortion.of(lens.camera, lens.radial) for name, lens in cloud.lenses.items()},
        unit=UNIT_OF_NEAR * near_depth(cloud.points, trained),
    )
    return Prepared(scene, cloud if cfg.init.source != "random" else None, folder)


def near_depth(points: np.ndarray, cameras: list[Camera]) -> float:
    """The depth that all but NEAR_QUANTILE of the points (N, 3) lie beyond, over all cameras, world units."""
    depths = np.concatenate([points @ c.world_to_cam[2, :3] + c.world_to_cam[2, 3] for c in cameras])
    return float(np.quantile(depths[depths > 0], NEAR_QUANTILE))


def _reconstruct(
    cfg: Config, photographs: list[Photograph], unit: float, source: Path, log: Callable[[str], None]
) -> tuple[Reconstruction, Path]:
    """Structure from motion, in the photographs' own world. COLMAP itself gets canonical coordinates: its solvers stop
    at absolute differences, in a world of thousands of units sooner."""
    from pipeline.data.sfm.store import reconstruct_once  # what scenes with random points do without

    log(f"sfm: {len(photographs)} cameras, first frames of {source}")
    known = [photograph.camera for photograph in photographs if photograph.camera is not None]
    frame = canonical_space(known, unit) if known else Canonical()
    if not frame.is_identity:
        photographs = [replace(photograph, camera=frame.camera(photograph.camera)) for photograph in photographs]
    cloud, folder = reconstruct_once(photographs, cfg.init, unit * frame.scale, source, Path(cfg.scene.cache))
    found = cloud.summary()
    log(
        f"sfm: {found['points']} points, mean error {found['mean_error_px']:.2f} px, in "
        f"{found['mean_track_length']:.1f} images each; kept in {folder}"
    )
    return _moved(cloud, frame.inverse), folder


def _moved(cloud: Reconstruction, frame: Canonical) -> Reconstruction:
    """Points and cameras in the coordinates that `frame` leads to."""
    if frame.is_identity:
        return cloud
    lenses = {name: replace(lens, camera=frame.camera(lens.camera)) for name, lens in cloud.lenses.items()}
    return replace(cloud, points=frame.points(cloud.points), lenses=lenses)
