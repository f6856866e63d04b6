"""Prepares the input of a run: reads the scene, runs structure from motion where needed, and normalises both.

    photographs of one moving camera         poses from the files, random initial points or those of the files
    posed multi-camera videos (plenoptic)    poses from the files, points triangulated from the first frames
    multi-camera videos without poses        poses and points from structure from motion
    driving logs                             poses from the files, points from LiDAR, else triangulated along the way
    one clip, or several cameras that move   the same, of all frames in use

Data are read in the units of their files. The result is in canonical coordinates (datasets/canonical.py), as is
everything computed from it.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from datasets import (
    Scene,
    is_drive,
    is_filmed,
    load_clip,
    load_clip_set,
    load_footage,
    load_posed,
    load_scene,
    reads_clip,
    reads_clip_set,
    with_reader,
)
from datasets.cameras.color import ColorCorrection
from datasets.canonical import Canonical, canonical_of, canonical_space, canonicalise
from datasets.scene import ScenePoints
from pipeline.config.schema import Config
from pipeline.data.sfm.photograph import Photograph, Reconstruction
from pipeline.data.training_views import evenly_spaced
from rasterizer.camera import Camera

if TYPE_CHECKING:  # imports a video decoder, which other scenes do not need
    from datasets.clip import Clip, ClipSet
    from datasets.plenoptic import Footage, PosedFootage

# Without depth bounds the 5 % quantile of the points' depths replaces the near bound. One normalised unit is 0.75 of
# it, as in LLFF (datasets/plenoptic/poses.py).
UNIT_OF_NEAR, NEAR_QUANTILE = 0.75, 0.05
DRIVE_PHOTOGRAPHS = 60  # images of a driving log, evenly spaced, that structure from motion takes


@dataclass(frozen=True)
class Prepared:
    """A scene and its initial points, in canonical coordinates."""

    scene: Scene
    cloud: Reconstruction | None  # None: random points
    sfm_folder: Path | None  # cache folder of the cloud, with its summary and plot
    canonical: Canonical = Canonical()  # transform from the files' units
    is_clip: bool = False  # one clip by a camera that moves, before normalisation in seconds


def prepare(cfg: Config, log: Callable[[str], None]) -> Prepared:
    """The scene of a config and its initial points. Structure from motion runs if its result is not in the cache.

    Normalisation comes last, because it depends on poses that structure from motion may estimate or refine. Raises
    ValueError for invalid data or settings.
    """
    cfg = replace(cfg, scene=with_reader(cfg.scene, log))
    data = _in_file_units(cfg, log)
    transform = canonical_of(data.scene)
    if not transform.is_identity:
        log(f"normalised: {transform}")
        cloud = None if data.cloud is None else _transformed(data.cloud, transform)
        data = replace(data, scene=canonicalise(data.scene, transform), cloud=cloud, canonical=transform)
    if data.cloud is None:
        return data
    return replace(data, scene=replace(data.scene, points=ScenePoints(data.cloud.points, data.cloud.colors)))


def _in_file_units(cfg: Config, log: Callable[[str], None]) -> Prepared:
    """Scene and points before normalisation."""
    several = not reads_clip(cfg.scene) and (cfg.scene.reader == "video" or is_filmed(cfg.scene))
    if cfg.scene.color_correction is True and (not several or cfg.init.source == "random"):
        why = "random points" if several else "a scene that is not several videos"
        raise ValueError(f"scene.color_correction: expected auto or false for {why}, found true")
    if cfg.scene.moving_cameras is True and not reads_clip_set(cfg.scene):
        raise ValueError("scene.moving_cameras: expected auto or false for a scene without several videos, found true")
    if reads_clip(cfg.scene):
        return _from_clip(cfg, load_clip(cfg.scene, log=log), log)
    if reads_clip_set(cfg.scene):
        return _from_clip_set(cfg, load_clip_set(cfg.scene, log=log), log)
    if cfg.scene.reader == "video":
        return _from_videos(cfg, load_footage(cfg.scene, threads=cfg.threads, log=log), log)
    if is_filmed(cfg.scene) and cfg.init.source != "random":
        return _from_posed(cfg, load_posed(cfg.scene, threads=cfg.threads, log=log), log)
    if is_drive(cfg.scene):
        return _from_drive(cfg, load_scene(cfg.scene, threads=cfg.threads, log=log), log)
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


def _from_posed(cfg: Config, posed: PosedFootage, log: Callable[[str], None]) -> Prepared:
    """Points from the full-size first frames of the training cameras; then the scene, whose frames may be smaller."""
    photographs = training_photographs(posed)
    cloud, folder = _reconstruct(cfg, photographs, posed.unit, posed.footage.source, log)
    if cloud.poses == "refined":
        refined = {name: found.camera for name, found in cloud.cameras.items()}
        posed = replace(posed, cameras={**posed.cameras, **refined})
    if cfg.scene.color_correction:
        cloud, colors = _corrected(cfg, photographs, cloud, (), log)
        posed = replace(posed, colors=colors)
        for name in posed.footage.held_out:
            log(f"colours of {name} are left alone: a held-out camera takes no part in structure from motion here")
    return Prepared(posed.to_scene(), cloud, folder)


def training_photographs(posed: PosedFootage) -> list[Photograph]:
    """The first frames of the training cameras, full size."""
    return [
        Photograph(name, image, posed.cameras[name])
        for name, image in posed.first_images().items()
        if name not in posed.footage.held_out
    ]


def _from_drive(cfg: Config, scene: Scene, log: Callable[[str], None]) -> Prepared:
    """A driving log. With LiDAR its points are taken from the sweeps later (model/initialise.py); without, or where
    `init.source` says so, structure from motion finds points with the log's poses."""
    if cfg.init.source == "lidar" and not scene.sweeps:
        raise ValueError(
            f"init.source: expected auto, sfm or random for {scene.source}, a log without LiDAR, found lidar"
        )
    from_lidar = scene.sweeps and cfg.init.source in ("auto", "lidar")
    if from_lidar and cfg.effective_background_model == "sphere":
        raise ValueError(
            f"background_model: expected cubemap, envmap or none for {scene.source}, whose points are LiDAR's, "
            "found sphere; init.source=sfm or random allows it"
        )
    if from_lidar or cfg.init.source == "random":
        return Prepared(scene, None, None)
    chosen = evenly_spaced(len(scene.train), DRIVE_PHOTOGRAPHS)
    photographs = [
        Photograph(view.name.replace("/", "_"), np.asarray(view.image), view.camera)
        for view in (scene.train[index] for index in chosen)
    ]
    cloud, folder = _reconstruct(cfg, photographs, scene.unit, scene.source, log)
    return Prepared(scene, cloud, folder)


def _from_videos(cfg: Config, footage: Footage, log: Callable[[str], None]) -> Prepared:
    """Poses and points from the distorted first frames; decoding then undistorts all frames."""
    from datasets.plenoptic import Undistortion

    photographs = [
        Photograph(name, image, held_out=name in footage.held_out) for name, image in footage.first_images().items()
    ]
    if footage.mixed_lenses:
        cfg = replace(cfg, init=replace(cfg.init, shared_intrinsics=False))
    cloud, folder = _reconstruct(cfg, photographs, 1.0, footage.source, log)
    colors: dict[str, ColorCorrection] = {}
    if cfg.scene.color_correction:
        cloud, colors = _corrected(cfg, photographs, cloud, footage.held_out, log)
    cameras = {name: found.camera for name, found in cloud.cameras.items()}
    train_cameras = [camera for name, camera in cameras.items() if name not in footage.held_out]
    scene = footage.to_scene(
        cameras,
        {name: Undistortion.of(found.camera, found.radial) for name, found in cloud.cameras.items()},
        unit=UNIT_OF_NEAR * near_depth(cloud.points, train_cameras),
        colors=colors,
        estimated=True,
    )
    return Prepared(scene, cloud if cfg.init.source != "random" else None, folder)


def _from_clip(cfg: Config, clip: Clip, log: Callable[[str], None]) -> Prepared:
    """Poses and points from the frames in use; the training images are these frames, undistorted and reduced."""
    from pipeline.data.sfm.cache import clip_reconstruct_cached

    photographs = [Photograph(frame.name, clip.photograph(frame)) for frame in clip.frames]
    width, height = photographs[0].image.shape[1], photographs[0].image.shape[0]
    log(f"sfm: {len(photographs)} frames of {clip.source.name}, {width} x {height}")
    cloud, folder = clip_reconstruct_cached(photographs, cfg.init, clip.source, Path(cfg.scene.cache), log)
    summary, lens = cloud.summary(), next(iter(cloud.cameras.values()))
    log(
        f"sfm: {summary['registered']} of {len(photographs)} frames registered, {summary['points']} points, mean error "
        f"{summary['mean_error_px']:.2f} px, focal length {lens.camera.fx:.1f} px; cached in {folder}"
    )
    cameras = {name: found.camera for name, found in cloud.cameras.items()}
    scene = clip.to_scene(cameras, lens.radial, UNIT_OF_NEAR * near_depth(cloud.points, list(cameras.values())))
    return Prepared(scene, cloud if cfg.init.source != "random" else None, folder, is_clip=True)


def _from_clip_set(cfg: Config, found: ClipSet, log: Callable[[str], None]) -> Prepared:
    """As one clip; the frames of each camera share a lens, and all are in one reconstruction."""
    from pipeline.data.sfm.cache import clip_reconstruct_cached

    photographs = [
        Photograph(name, camera.clip.photograph(frame), lens=camera.name, time=camera.time(frame))
        for name, camera, frame in found.photographs()
    ]
    log(f"sfm: {len(photographs)} frames of {len(found.cameras)} cameras in {found.source.name}")
    corrected = bool(cfg.scene.color_correction)
    held_out = [camera.name for camera in found.cameras if camera.number in found.settings.test_cameras]
    cloud, folder = clip_reconstruct_cached(
        photographs, cfg.init, found.source, Path(cfg.scene.cache), log, observations=corrected
    )
    summary = cloud.summary()
    log(
        f"sfm: {summary['registered']} of {len(photographs)} frames registered, {summary['points']} points, mean error "
        f"{summary['mean_error_px']:.2f} px; cached in {folder}"
    )
    colors: dict[str, ColorCorrection] = {}
    if corrected:
        cloud, colors = _corrected(cfg, photographs, cloud, held_out, log)
    cameras = {name: calibrated.camera for name, calibrated in cloud.cameras.items()}
    radial = {p.lens: cloud.cameras[p.name].radial for p in photographs if p.name in cloud.cameras}
    unit = UNIT_OF_NEAR * near_depth(cloud.points, list(cameras.values()))
    scene = found.to_scene(cameras, radial, unit, colors)
    return Prepared(scene, cloud if cfg.init.source != "random" else None, folder)


def _corrected(
    cfg: Config,
    photographs: list[Photograph],
    cloud: Reconstruction,
    held_out: Collection[str],
    log: Callable[[str], None],
) -> tuple[Reconstruction, dict[str, ColorCorrection]]:
    """The corrections of the cameras' colours by scene.color_correction, and the points in corrected colours."""
    from pipeline.data.colors import color_corrections, recolored  # not needed by scenes without it

    found = color_corrections(photographs, cloud, held_out, cfg.scene.color_correction is True, log)
    return recolored(photographs, cloud, held_out, found), found


def near_depth(points: np.ndarray, cameras: list[Camera]) -> float:
    """The NEAR_QUANTILE of the depths of points (N, 3) in front of all cameras, world units."""
    depths = np.concatenate([points @ c.world_to_cam[2, :3] + c.world_to_cam[2, 3] for c in cameras])
    return float(np.quantile(depths[depths > 0], NEAR_QUANTILE))


def _reconstruct(
    cfg: Config, photographs: list[Photograph], unit: float, source: Path, log: Callable[[str], None]
) -> tuple[Reconstruction, Path]:
    """Structure from motion; the result is in the units of the photographs' cameras.

    COLMAP works in canonical coordinates, because the tolerances of its solvers are absolute.
    """
    from pipeline.data.sfm.cache import reconstruct_cached  # not needed by scenes with random points

    log(f"sfm: {len(photographs)} images of {source}")
    known = [photograph.camera for photograph in photographs if photograph.camera is not None]
    transform = canonical_space(known, unit) if known else Canonical()
    if not transform.is_identity:
        photographs = [  # all of them have a camera, or none has
            replace(photograph, camera=transform.camera(camera))
            for photograph, camera in zip(photographs, known, strict=True)
        ]
    cloud, folder = reconstruct_cached(
        photographs,
        cfg.init,
        unit * transform.scale,
        source,
        Path(cfg.scene.cache),
        observations=bool(cfg.scene.color_correction),
    )
    summary = cloud.summary()
    log(
        f"sfm: {summary['points']} points, mean error {summary['mean_error_px']:.2f} px, mean track length "
        f"{summary['mean_track_length']:.1f}; cached in {folder}"
    )
    return _transformed(cloud, transform.inverse), folder


def _transformed(cloud: Reconstruction, transform: Canonical) -> Reconstruction:
    """The reconstruction with points and cameras transformed."""
    if transform.is_identity:
        return cloud
    cameras = {name: replace(found, camera=transform.camera(found.camera)) for name, found in cloud.cameras.items()}
    return replace(cloud, points=transform.points(cloud.points), cameras=cameras)
