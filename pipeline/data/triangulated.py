"""Points of images whose poses are given: COLMAP's triangulation with the poses fixed, from one moment or from all.

One moment where several cameras saw it. All images where nothing moves, or where the camera does; what moves is then
masked, and what the data mask always.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from datasets.camera_readings import look_at_one_point, other_readings
from datasets.files.errors import SceneError
from datasets.photographs.scene import FileImage
from datasets.scene import Scene, ScenePoints, View
from datasets.source import Photograph
from pipeline.config.schema import Config
from pipeline.data.from_motion import canonical_reconstruction
from pipeline.data.sfm.reconstruction import Reconstruction
from pipeline.data.sfm.run import Matching
from pipeline.data.training_views import evenly_spaced

SIDES = (1024, 2048)  # pixels: the longer side of the images, the second where the first finds too little
ENOUGH = 1000  # points, with which larger images are not tried
MOST_IMAGES = 150  # evenly spaced ones of more
PROVEN = 3  # × the points of the poses as read: by as many another reading of them is proven
SEVERAL = 4  # cameras: from as many at one time, that moment is enough
ALL_PAIRS = 25  # images: of more each is matched with those of these ranks in nearness only
RANKS = (0, 1, 2, 3, 4, 6, 8, 12, 16, 24)


@dataclass(frozen=True)
class Triangulated:
    """Points in the scene's units."""

    cloud: Reconstruction
    folder: Path  # in the cache
    points: ScenePoints  # the same, with the views that show each
    line: str  # what was found, and from what


@dataclass(frozen=True)
class TooFew:
    count: int
    line: str  # what was found, and from what


@dataclass(frozen=True)
class Chosen:
    """The views whose images are matched, in order."""

    views: tuple[View, ...]
    what: str  # for messages
    in_order: bool = False  # one camera filmed them


def triangulated(cfg: Config, scene: Scene, sides: Sequence[int] = SIDES) -> Triangulated | TooFew:
    """What is found, or that it is less than init.min_points."""
    chosen = views_to_match(scene)
    if chosen is None:
        return TooFew(0, "none: each image is of another time and place")
    best: tuple[Reconstruction, Path, tuple[int, ...]] | None = None
    size: tuple[int, ...] = ()
    failed = ""
    for side in sides:
        photographs, ignored = photographs_of(chosen.views, side)
        if photographs[0].image.shape == size:
            break
        size = photographs[0].image.shape
        init = replace(cfg.init, min_points=1, refine_poses=False)
        matching = Matching(nearest_pairs(photographs), ignored, chosen.in_order)
        try:
            cloud, folder = canonical_reconstruction(
                init, photographs, scene.unit, scene.source, Path(cfg.scene.cache), True, matching
            )
        except ValueError as error:
            failed = "" if "init.min_points" in str(error) else f" ({error})"
            continue
        if best is None or len(cloud.points) > len(best[0].points):
            best = cloud, folder, size
        if len(cloud.points) >= ENOUGH:
            break
    if best is None or len(best[0].points) < cfg.init.min_points:
        count = len(best[0].points) if best else 0
        line = f"{count} triangulated from {chosen.what}, fewer than init.min_points={cfg.init.min_points}{failed}"
        return TooFew(count, line)
    cloud, folder, (height, width, _) = best
    line = (
        f"{len(cloud.points)} triangulated from {chosen.what} at {width} x {height} pixels, with the poses as given, "
        f"mean error {cloud.errors.mean():.2f} px; cached in {folder}"
    )
    # An object without background has few features, and none where it is of one colour.
    sparse = len(cloud.points) < ENOUGH or any(view.coverage is not None for view in chosen.views)
    points = ScenePoints(cloud.points, cloud.colors, seen_by=_seen_by(cloud, scene), sparse=sparse)
    return Triangulated(cloud, folder, points, line)


def refuse_misread_poses(cfg: Config, scene: Scene, found: int, log: Callable[[str], None]) -> None:
    """SceneError if the images agree on the poses in another reading; a line where only the optical axes suggest it.

    found: the number of points that they agree on as the poses are.
    """
    cameras = [view.camera for view in (*scene.train, *scene.test)]
    suspected = not look_at_one_point(cameras)
    for reading, reread in other_readings(cameras).items():
        turned = tuple(replace(view, camera=camera) for view, camera in zip(scene.train, reread))
        made = triangulated(cfg, replace(scene, train=turned), SIDES[:1])
        if isinstance(made, Triangulated) and len(made.cloud.points) >= PROVEN * found:
            raise SceneError(
                scene.source,
                "poses that the images agree on",
                f"{found} points with the poses as they are read, {len(made.cloud.points)} with {reading}",
            )
        if suspected:
            log(
                f"cameras: their optical axes meet nowhere before them; with {reading} all look at one point. The "
                "images do not tell which is right: check the poses"
            )


def views_to_match(scene: Scene) -> Chosen | None:
    """Which training views show the same points; None for photographs of one camera that jumps while things move."""
    moments: dict[float, list[View]] = defaultdict(list)
    for view in scene.train:
        moments[view.time].append(view)
    most = max(moments, key=lambda time: len(moments[time]))
    if scene.capture == "multi_view" and (len(moments[most]) >= SEVERAL or scene.train[0].filmed_by):
        return Chosen(tuple(moments[most]), f"the {len(moments[most])} images of one time")
    if scene.capture == "monocular":
        return None
    views = tuple(scene.train[index] for index in evenly_spaced(len(scene.train), MOST_IMAGES))
    return Chosen(views, f"{len(views)} of {len(scene.train)} images", scene.capture == "clip")


def photographs_of(views: Sequence[View], side: int) -> tuple[list[Photograph], dict[str, np.ndarray]]:
    """(for structure from motion, in world units; name -> (H, W) bool of the pixels that the data's masks leave out).

    A longer side of `side` pixels at most where files are larger than the views' images.
    """
    found, ignored = [], {}
    for view in views:
        image, camera, mask = np.asarray(view.image), view.camera, view.mask
        if isinstance(view.image, FileImage):
            image, camera, mask = view.image.larger(side)
            camera = replace(camera, world_to_cam=view.camera.world_to_cam)
        found.append(Photograph(_name(view), image, camera))
        if mask is not None:
            ignored[_name(view)] = ~mask
    return found, ignored


def nearest_pairs(photographs: Sequence[Photograph]) -> list[tuple[str, str]] | None:
    """Each with the nearest by place and direction, of the ranks RANKS; None where few enough to match all."""
    if len(photographs) <= ALL_PAIRS:
        return None
    cameras = [photograph.camera for photograph in photographs if photograph.camera is not None]
    places = np.stack([camera.position for camera in cameras])
    axes = np.stack([camera.world_to_cam[2, :3] for camera in cameras])
    apart = np.linalg.norm(places[:, None] - places[None], axis=2)
    cost = apart / apart.max() + np.arccos(np.clip(axes @ axes.T, -1, 1))
    np.fill_diagonal(cost, np.inf)
    order = np.argsort(cost, axis=1, kind="stable")
    pairs = {tuple(sorted((i, int(order[i, rank])))) for i in range(len(cameras)) for rank in RANKS}
    return [(photographs[i].name, photographs[j].name) for i, j in sorted(pairs)]


def _seen_by(cloud: Reconstruction, scene: Scene) -> dict[str, np.ndarray]:
    """As ScenePoints.seen_by."""
    assert cloud.observations is not None
    rows, places = cloud.observations[:, 0].astype(int), cloud.observations[:, 1].astype(int)
    place_of = {name: place for place, name in enumerate(cloud.cameras)}
    found = {view.name: place_of.get(_name(view)) for view in scene.train}
    return {name: np.unique(rows[places == place]) for name, place in found.items() if place is not None}


def _name(view: View) -> str:
    """Of the view's photograph, whose file has it."""
    return view.name.replace("/", "_")
