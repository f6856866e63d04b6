"""The initial points of a scene by carving, in its coordinates; or why there are none."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from datasets.camera_box import box_of_cameras
from datasets.scene import Scene, ScenePoints, View
from datasets.urban.projection import in_image, project
from pipeline.data.carving.carve import CameraFilm, Carved, carve
from pipeline.data.training_views import evenly_spaced
from rasterizer.camera import Camera

FEWEST_CAMERAS, MOST_CAMERAS = 2, 16  # of more, features of neighbours match
SIDE = 160  # pixels of the longer side of the images that are carved
TIMES = 20
MOVING_SHARE = 0.5  # of the points at most
LEAST_FOUND = 0.5  # of the moving pixels that hulls explain; of cameras that agree 0.98 (arena, real mouse)
HALF = 127  # of 255: alpha of a pixel of the silhouette
# Of a held-out image in tiles, those with a point. Measured: 0.77 and 0.51 gain 3 dB on the best mean picture, 0.16 is
# no picture.
TILES, LEAST_COVERED = 24, 0.4
LEAST_SWEPT = 0.02  # of the background's pixels, where nothing moves
SPAN = 0.5  # standard deviation in time of what moves, × the distance of the times


def carved_points(scene: Scene, budget: int, rng: np.random.Generator) -> tuple[ScenePoints | None, str]:
    """At most `budget` points and a line on them; None and the reason.

    ValueError where the cameras contradict each other: no training would mend that.
    """
    if scene.capture not in ("multi_view", "static"):
        return None, "each time is seen from one place"
    films = films_of(scene.train)
    if not FEWEST_CAMERAS <= len(films) <= MOST_CAMERAS:
        return None, f"{len(films)} cameras that stand still, not {FEWEST_CAMERAS} to {MOST_CAMERAS}"
    box = box_of_cameras([views[0].camera for views in films.values()])
    if box is None:
        return None, "the cameras see no place in common"
    times = common_times(films)
    found = carve([_small(films[name], times) for name in films], box)
    names = ", ".join(sorted(films))
    if found.found < LEAST_FOUND:
        raise ValueError(
            f"{scene.source}: expected what moves to be at one place in all cameras ({names}), found that by their "
            f"poses and times {100 * found.found:.0f} % of the moving pixels are: a wrong calibration, cameras under "
            "each other's names, or videos that did not start together; init.source=random trains nevertheless"
        )
    if not found.moving.any() and found.swept < LEAST_SWEPT:
        return None, "nothing moves, and no texture is alike in two cameras"
    kept = thinned(found, budget, rng)
    at = np.array([*times, np.nan])[np.where(kept.moving, kept.times, len(times)).astype(int)]
    spacing = scene.duration / max(1, len(times) - 1)
    agree = (
        "too little to judge the cameras by"
        if np.isnan(found.found)
        else f"{100 * found.found:.0f} % of its pixels agree"
    )
    line = (
        f"{len(kept.points)} carved from {len(films)} cameras: {np.count_nonzero(kept.moving)} of what moves at "
        f"{len(times)} times, {agree}; the background's depth is known of {100 * found.swept:.0f} % of its pixels, "
        "the rest is put behind the cameras"
    )
    held_out = {view.camera.world_to_cam.tobytes(): view for view in scene.test}.values()
    if poor := [v.filmed_by or v.name for v in held_out if covered_share(kept.points, v.camera) < LEAST_COVERED]:
        line += (
            f"; {', '.join(sorted(poor))}, held out, sees them in less than {100 * LEAST_COVERED:.0f} % of its image: "
            "the rest is before no training camera, and its numbers will say little; hold out a camera between "
            "others (scene.test_cameras)"
        )
    return ScenePoints(kept.points, kept.colors, times=at, span=SPAN * spacing), line


def covered_share(points: np.ndarray, camera: Camera) -> float:
    """The share of the image's tiles, a TILES-th of its width each, with one of the points (N, 3)."""
    small = camera.resized(TILES, max(1, round(TILES * camera.height / camera.width)))
    column, row, depth = project(points, small)
    seen = in_image(column, row, depth, small)
    return len(np.unique(row[seen].astype(int) * TILES + column[seen].astype(int))) / (small.width * small.height)


def films_of(views: Sequence[View]) -> dict[str, list[View]]:
    """The views of each camera that stands still; of photographs of one moment each is a camera of its own."""
    films: dict[str, list[View]] = defaultdict(list)
    for view in views:
        films[view.filmed_by or view.name].append(view)
    return {name: found for name, found in films.items() if len({v.camera.world_to_cam.tobytes() for v in found}) == 1}


def common_times(films: dict[str, list[View]]) -> list[float]:
    """At most TIMES evenly spaced times of the camera with the fewest views."""
    fewest = min(films.values(), key=len)
    ordered = sorted(view.time for view in fewest)
    return [ordered[index] for index in evenly_spaced(len(ordered), TIMES)]


def _small(views: list[View], times: Sequence[float]) -> CameraFilm:
    """Of each time the nearest view, small."""
    own = np.array([view.time for view in views])
    camera = views[0].camera
    scale = min(1.0, SIDE / max(camera.width, camera.height))
    size = max(1, round(camera.width * scale)), max(1, round(camera.height * scale))
    chosen = [views[int(np.abs(own - time).argmin())] for time in times]
    images = np.stack([cv2.resize(np.asarray(v.image), size, interpolation=cv2.INTER_AREA) for v in chosen])
    alphas = [v.coverage for v in chosen if v.coverage is not None]
    inside = [cv2.resize(alpha, size, interpolation=cv2.INTER_AREA) > HALF for alpha in alphas]
    return CameraFilm(camera.resized(*size), images, np.stack(inside) if len(inside) == len(chosen) else None)


def thinned(carved: Carved, budget: int, rng: np.random.Generator) -> Carved:
    """At most `budget` points, MOVING_SHARE of them of what moves, as many at each time as it has of all."""
    moving, still = np.flatnonzero(carved.moving), np.flatnonzero(~carved.moving)
    most = min(len(moving), max(round(MOVING_SHARE * budget), budget - len(still)))
    kept = np.sort(rng.choice(moving, most, replace=False)) if most < len(moving) else moving
    left = min(len(still), budget - len(kept))
    kept = np.concatenate([kept, np.sort(rng.choice(still, left, replace=False)) if left < len(still) else still])
    return replace(carved, points=carved.points[kept], colors=carved.colors[kept], times=carved.times[kept])
