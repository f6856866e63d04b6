"""Prepares the input of a run: opens its data, runs structure from motion where needed, and normalises both.

Data are read in the units of their files. The result is in canonical coordinates (datasets/canonical.py), as is
everything computed from it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from datasets.canonical import Canonical, canonical_of, canonicalise
from datasets.files.errors import SceneError
from datasets.leaks import trained_test_views
from datasets.outliers import inliers
from datasets.scene import Scene, ScenePoints
from datasets.settings import SceneConfig
from datasets.source import Source, open_source
from datasets.urban.projection import in_image, project
from pipeline.config.random_streams import Stream, stream
from pipeline.config.schema import Config
from pipeline.data.carving.start import carved_points
from pipeline.data.from_motion import UNIT_OF_NEAR, near_depth, structure_from_motion, transformed
from pipeline.data.initial_box import with_box_of_cameras, with_set_box
from pipeline.data.sfm.reconstruction import Reconstruction
from pipeline.data.sfm.run import TooFewPoints
from pipeline.data.triangulated import Triangulated, refuse_misread_poses, triangulated

SEEN = 0.1  # of the given points: where cameras see fewer, they are none of the scene
LOOKED_AT, FEW_CAMERAS = 10_000, 100  # as many points and cameras suffice for that


@dataclass(frozen=True)
class Prepared:
    """A scene and its initial points, in canonical coordinates."""

    scene: Scene
    cloud: Reconstruction | None  # None: random points, or those of LiDAR
    sfm_folder: Path | None  # cache folder of the cloud, with its summary and plot
    canonical: Canonical = Canonical()  # transform from the files' units
    poses_estimated: bool = False  # of every frame: the user's own videos by cameras that move
    settings: SceneConfig | None = None  # as the data were read: the layout and the split found out; None: as given
    points: str = "random"  # where the initial points come from: given (with the files), sfm, lidar, carved or random


def prepare(cfg: Config, log: Callable[[str], None]) -> Prepared:
    """The scene of a config and its initial points. Structure from motion runs if its result is not in the cache.

    Normalisation comes last, because it depends on poses that structure from motion may estimate or refine. Raises
    ValueError for invalid data or settings.
    """
    source = open_source(cfg.scene, threads=cfg.threads, log=log)
    scene_cfg = source.cfg
    cfg = replace(cfg, scene=scene_cfg)
    points = points_from(cfg, source)
    posed_images = source.poses == "given" and source.points in ("given", "random")
    cloud, folder, found, initial, few = None, None, None, None, None
    runs_sfm = (points == "sfm" and not posed_images) or source.poses != "given"
    if cfg.init.refine_poses and (not runs_sfm or source.points == "lidar"):
        raise ValueError(f"init.refine_poses: expected false for {source.path}, whose poses are kept, found true")
    if runs_sfm:
        try:
            cloud, folder, found = structure_from_motion(cfg, source, log)
        except TooFewPoints as error:
            if source.poses != "given" or cfg.init.source == "sfm":
                raise
            points, few = "carved", error
    scene = source.scene(found)
    if points == "given":
        cloud = given_points(cfg, scene, log)
    elif points != "sfm":
        cloud = None  # it has found the poses
    if posed_images and points in ("given", "sfm") and cloud is None:
        made = points_of_poses(cfg, scene, points == "sfm", log)
        if made is not None:
            points, cloud, folder, initial = "sfm", made.cloud, made.folder, made.points
            trained = [view.camera for view in scene.train]
            scene = replace(scene, unit=min(scene.unit, UNIT_OF_NEAR * near_depth(cloud.points, trained)))
    transform = canonical_of(scene)
    if not transform.is_identity:
        log(f"normalised: {transform}")
        cloud = None if cloud is None else transformed(cloud, transform)
    name_outliers(scene, log)
    scene = name_leaks(scene, log)
    if cloud is not None:
        initial = replace(initial or ScenePoints(cloud.points, cloud.colors), positions=cloud.points)
    scene = replace(canonicalise(scene, transform), points=initial)
    if points == "carved" or (points == "given" and cloud is None):
        carved, line = carved_points(scene, cfg.train.init_points, stream(cfg.seed, Stream.INIT))
        if carved is None and points == "carved":
            what = few or f"init.source: expected auto or random for {source.path}, found carved"
            raise ValueError(f"{what}; no points can be carved: {line}")
        points = "random" if carved is None else "carved"
        if carved is not None:
            log(f"points: {line}")
            scene = replace(scene, points=carved)
            if source.cfg.background_model == "sphere":
                log("scene.background_model: none in place of sphere, which carved points have not")
                scene_cfg = replace(scene_cfg, background_model="none")
    some_random = points == "random" or (initial is not None and initial.sparse)
    scene = boxed(scene, source.cfg, source.guessed_box and some_random, log)
    return Prepared(scene, cloud, folder, transform, source.poses == "of every frame", scene_cfg, points)


def points_from(cfg: Config, source: Source) -> str:
    """Where the initial points come from: given (with the files), sfm, lidar or random. Those of LiDAR are taken from
    the scene's sweeps later (model/initialise.py). ValueError for settings that do not fit the source."""
    lidar, asked = source.points == "lidar", cfg.init.source
    if asked == "lidar" and not lidar:
        raise ValueError("init.source: expected auto, random or sfm for a scene without LiDAR, found lidar")
    if asked == "given" and source.points != "given":
        raise ValueError(f"init.source: expected auto, {source.points} or random for {source.path}, found given")
    if cfg.scene.color_correction is True and (not source.several_videos or asked == "random"):
        why = "random points" if source.several_videos else "a scene that is not several videos"
        raise ValueError(f"scene.color_correction: expected auto or false for {why}, found true")
    if cfg.scene.moving_cameras is True and not (source.several_videos and source.poses == "of every frame"):
        raise ValueError("scene.moving_cameras: expected auto or false for a scene without several videos, found true")
    if lidar and asked in ("auto", "lidar") and cfg.scene.background_model == "sphere":
        raise ValueError(
            f"scene.background_model: expected cubemap, envmap or none for {source.path}, whose points are LiDAR's, "
            "found sphere; init.source=sfm or random allows it"
        )
    return source.points if asked == "auto" else asked


def points_of_poses(cfg: Config, scene: Scene, asked: bool, log: Callable[[str], None]) -> Triangulated | None:
    """Points triangulated with the poses as given; None where these are too few, unless they are `asked` for."""
    made = triangulated(cfg, scene)
    if isinstance(made, Triangulated):
        log(f"points: {made.line}")
        return made
    refuse_misread_poses(cfg, scene, made.count, log)
    if asked:
        raise SceneError(scene.source, "points that all poses agree on (init.source=sfm)", made.line)
    if scene.capture != "monocular":
        log(f"points: {made.line}")
    return None


def boxed(scene: Scene, settings: SceneConfig, from_cameras: bool, log: Callable[[str], None]) -> Scene:
    """A scene in canonical coordinates with the box of random points that is set, or, `from_cameras`, that they see."""
    if settings.init_box is not None:
        return with_set_box(scene, settings.init_box)
    if not from_cameras:
        return scene
    scene, where = with_box_of_cameras(scene)
    if where:
        log(f"points: random ones {where}; scene.init_box sets another place")
    return scene


def given_points(cfg: Config, scene: Scene, log: Callable[[str], None]) -> Reconstruction | None:
    """The points that came with the data; None without any, and where they are too few."""
    if scene.points is None:
        return None
    positions, colors = scene.points.positions, scene.points.colors
    if not (kept := inliers(positions)).all():
        log(f"points: {np.count_nonzero(~kept)} of {len(kept)} lie far beyond the others and are left out")
        positions, colors = positions[kept], colors[kept]
    cameras = list({view.camera.world_to_cam.tobytes(): view.camera for view in scene.train}.values())
    some = positions[:: max(1, len(positions) // LOOKED_AT)]
    chosen = cameras[:: max(1, len(cameras) // FEW_CAMERAS)]
    seen = np.mean(np.any([in_image(*project(some, camera), camera) for camera in chosen], axis=0))
    if seen < SEEN:
        log(
            f"points: {100 * seen:.0f} % of {len(positions)} are before a camera, as if not in the coordinates of "
            "the poses: they are left out"
        )
        return None
    count = len(positions)
    if count < cfg.init.min_points:
        log(f"the folder's {count} points are fewer than init.min_points={cfg.init.min_points}: they are left out")
        return None
    unknown = np.zeros(count)
    return Reconstruction(positions, colors, unknown, unknown.astype(int), {}, "known", len(scene.train), 0.0)


def name_leaks(scene: Scene, log: Callable[[str], None]) -> Scene:
    """The scene; where test views are training views, with a line in the log and in tables."""
    if not (found := trained_test_views(scene)):
        return scene
    what = f"{len(found)} of {len(scene.test)} test views are training views"
    log(f"{what} ({found[0][0]} is {found[0][1]}): their numbers are no held-out ones")
    return replace(scene, test_split=f"{scene.test_split or 'the test split'}; {what}")


def name_outliers(scene: Scene, log: Callable[[str], None]) -> None:
    """A line on cameras that are outliers: they are trained on, but decide no centre, unit or extent."""
    views = scene.train + scene.test
    kept = inliers(np.stack([view.camera.position for view in views]))
    kept[: len(scene.train)] = inliers(np.stack([view.camera.position for view in scene.train]))  # these decide
    if not kept.all():
        far = [view.name for view, inside in zip(views, kept) if not inside]
        log(
            f"cameras: {', '.join(far[:3])}{' …' if len(far) > 3 else ''} ({len(far)} of {len(kept)} views) far beyond "
            "the others, a wrong pose? They do not count in the scene's centre, unit and extent"
        )
