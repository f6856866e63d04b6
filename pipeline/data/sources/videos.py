"""Videos of several cameras that stand still: their first frames have the poses and points of all times."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

from datasets import load_footage, load_posed
from datasets.cameras.color import ColorCorrection
from pipeline.config.schema import Config
from pipeline.data.prepared import Prepared
from pipeline.data.sfm.photograph import Photograph
from pipeline.data.sources.reconstruct import corrected_colors, normalised_unit, reconstruct

if TYPE_CHECKING:  # imports a video decoder, which other scenes do not need
    from datasets.plenoptic import PosedFootage


def from_posed_videos(cfg: Config, log: Callable[[str], None]) -> Prepared:
    """Points from the full-size first frames of the training cameras; then the scene, whose frames may be smaller."""
    posed = load_posed(cfg.scene, threads=cfg.threads, log=log)
    if cfg.init.source == "random":
        return Prepared(posed.to_scene(), None, None)
    photographs = training_photographs(posed)
    cloud, folder = reconstruct(cfg, photographs, posed.unit, posed.footage.source, log)
    if cloud.poses == "refined":
        refined = {name: found.camera for name, found in cloud.cameras.items()}
        posed = replace(posed, cameras={**posed.cameras, **refined})
    if cfg.scene.color_correction:
        cloud, colors = corrected_colors(cfg, photographs, cloud, (), log)
        posed = replace(posed, colors=colors)
        for name in posed.footage.held_out:
            log(f"colours of {name} are left alone: a held-out camera takes no part in structure from motion here")
    return Prepared(posed.to_scene(), cloud, folder)


def from_videos(cfg: Config, log: Callable[[str], None]) -> Prepared:
    """Poses and points from the distorted first frames; decoding then undistorts all frames."""
    from datasets.plenoptic import Undistortion

    footage = load_footage(cfg.scene, threads=cfg.threads, log=log)
    photographs = [
        Photograph(name, image, held_out=name in footage.held_out) for name, image in footage.first_images().items()
    ]
    if footage.mixed_lenses:
        cfg = replace(cfg, init=replace(cfg.init, shared_intrinsics=False))
    cloud, folder = reconstruct(cfg, photographs, 1.0, footage.source, log)
    colors: dict[str, ColorCorrection] = {}
    if cfg.scene.color_correction:
        cloud, colors = corrected_colors(cfg, photographs, cloud, footage.held_out, log)
    cameras = {name: found.camera for name, found in cloud.cameras.items()}
    train_cameras = [camera for name, camera in cameras.items() if name not in footage.held_out]
    scene = footage.to_scene(
        cameras,
        {name: Undistortion.of(found.camera, found.radial) for name, found in cloud.cameras.items()},
        unit=normalised_unit(cloud.points, train_cameras),
        colors=colors,
        estimated=True,
    )
    return Prepared(scene, cloud if cfg.init.source != "random" else None, folder)


def training_photographs(posed: PosedFootage) -> list[Photograph]:
    """The first frames of the training cameras, full size."""
    return [
        Photograph(name, image, posed.cameras[name])
        for name, image in posed.first_images().items()
        if name not in posed.footage.held_out
    ]
