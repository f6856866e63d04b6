"""Full evaluation of a model on the test views (docs/method.md 4): image metrics, flicker, speed, images and videos.

Every metric is measured on every test view, except LPIPS-VGG in large scenes (lpips.py). Flicker is measured on
every pair of consecutive frames, speed on evenly spread views (speed.py). At 1352 × 1014 pixels a view takes 3 s of one
core, LPIPS-Alex included. quick_evaluate.py is the cheap version for use during training.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from datasets.ground_truth import GroundTruth
from datasets.scene import Scene
from datasets.urban.projection import depth_image
from pipeline.config.schema import Config
from pipeline.data.training_views import Target, camera_at, evenly_spaced, target_of
from pipeline.evaluation.image_metrics import MS_SSIM_SMALLEST_SIDE, SSIM_SMALLEST_SIDE, FlickerMeter, Geometry
from pipeline.evaluation.lpips import Perceptual
from pipeline.evaluation.metrics import MeasuredView, SeeView, means, measure
from pipeline.evaluation.moving_pixels import MovingPixels
from pipeline.evaluation.pictures.films import held_out_films, write_bullet_time, write_clip_films
from pipeline.evaluation.pictures.view_pictures import picture_saver
from pipeline.evaluation.renderer import Renderer, frames_per_second
from pipeline.model.model import Model
from rasterizer import Camera, engine_for

METRICS_BYTES_PER_PIXEL = 400  # memory while a view is measured, its images and LPIPS-Alex included, without LPIPS-VGG
MEASURE_BYTES = 4 * 1024**3  # memory limit for the views that are measured in parallel


@dataclass(frozen=True)
class Rendered:
    """One test view as a model, or anyone, renders it."""

    image: np.ndarray  # (H, W, 3) float32 in [0, 1]
    n_alive: int | None = None  # Gaussians with temporal marginal p(t) >= 0.05
    geometry: Geometry | None = None


# Of the index of a test view, what it is compared with, and the ground truth and LiDAR depths (H, W) that are known.
Render = Callable[[int, Target, GroundTruth | None, np.ndarray | None], Rendered]


@dataclass(frozen=True)
class Evaluation:
    """Means over the test views, and the rows that they are means of."""

    # metrics.METRICS but for costs; *_note where a number is missing; moving_by: how the dynamic region is known
    metrics: dict[str, float | str | None]
    per_image: list[
        dict
    ]  # view, time (seconds since the first), the metrics of a view, moving_share (of its pixels), n_alive
    n_alive_mean: float | None  # Gaussians with temporal marginal p(t) >= 0.05, mean over the views
    lpips_weights: dict[str, str]  # SHA-256 of LPIPS's files by name; empty: not measured

    def note(self) -> str | None:
        """Why numbers are missing, or None."""
        notes = [str(value) for name, value in self.metrics.items() if name.endswith("_note") and value]
        return "; ".join(notes) or None


def refuse_small_images(scene: Scene, scale: float) -> None:
    """ValueError, one line, if a test view at `scale` of its size is smaller than SSIM's window."""
    for view in scene.test:
        camera = camera_at(view.camera, scale)
        if min(camera.width, camera.height) < SSIM_SMALLEST_SIDE:
            raise ValueError(
                f"{view.name}: SSIM needs images of at least {SSIM_SMALLEST_SIDE} px a side, found {camera.width} x "
                f"{camera.height}; lower scene.downscale, or raise scene.size or train.resolution_scale"
            )


def evaluate(
    model: Model, scene: Scene, cfg: Config, threads: int, save: SeeView | None = None, film: SeeView | None = None
) -> Evaluation:
    """Measure `model` on every test view of `scene`, at the final resolution of training.

    Renders are clamped to [0, 1] and not rounded to 8 bits. save: called with the views that `cfg.evaluate.renders`
    selects. film: called with the camera of all of them. Both are called camera by camera in the order of time, if
    views are frames of videos. Raises ValueError for a model that is not finite.
    """
    if wrong := model.first_non_finite():  # a render would not show it: max(0, NaN) is 0
        raise ValueError(
            f"model to evaluate: expected finite values, found NaN or Inf in {wrong[0]} of Gaussian {wrong[1]}"
        )
    render = rendered_by(Renderer(model, scene, cfg, engine_for(cfg.backend, threads)))
    found = measure_images(scene, cfg, threads, render, save, film)
    found.metrics["fps_render"], found.metrics["fps_raster"] = frames_per_second(model, scene, cfg, threads)
    return found


def rendered_by(renderer: Renderer) -> Render:
    """A model's own views."""

    def render(index: int, target: Target, known: GroundTruth | None, lidar: np.ndarray | None) -> Rendered:
        image, alive = renderer.image(target.camera, target.time), renderer.rasterizer.alive
        return Rendered(image, alive, _geometry_of(renderer, target, known, lidar))

    return render


def measure_images(
    scene: Scene, cfg: Config, threads: int, render: Render, save: SeeView | None = None, film: SeeView | None = None
) -> Evaluation:
    """What images of all test views are worth; of a model beside its speed. render, save, film: as in `evaluate`."""
    perceptual, flicker = Perceptual(cfg, scene), FlickerMeter(scene.frame_rate)
    moving = MovingPixels(scene, cfg.train.resolution_scale)
    sweeps = {sweep.frame: sweep for sweep in scene.test_sweeps}
    has_alpha = any(view.coverage is not None for view in scene.test)
    saved = set(evenly_spaced(len(scene.test), cfg.evaluate.renders))
    rows: dict[int, dict] = {}  # by index of the view

    # Rendering takes milliseconds on all threads, measuring a quarter of a second on one: several views in parallel.
    order = list(range(len(scene.test)))
    if scene.frame_rate is not None:
        order.sort(key=lambda i: (scene.test[i].filmed_by, scene.test[i].time))
    parallel = _parallel_views(scene.test[0].camera, threads, perceptual.bytes_per_pixel)
    with ThreadPoolExecutor(parallel) as pool:
        for first in range(0, len(order), parallel):
            indices = order[first : first + parallel]
            measured, n_alive = [], []
            for index in indices:
                view = scene.test[index]
                target = target_of(view, cfg.train.resolution_scale)
                sweep = sweeps.get(-1 if view.frame is None else view.frame)
                lidar = None if sweep is None else depth_image(sweep.points, target.camera)
                known = moving.truth_of(index)
                rendered = render(index, target, known, lidar)
                image, truth = rendered.image, target.image.numpy().transpose(1, 2, 0)
                n_alive.append(rendered.n_alive)
                measured.append(
                    MeasuredView(
                        image,
                        truth,
                        foreground=_foreground(target, image) if has_alpha else None,
                        valid=None if target.mask is None else target.mask.numpy(),
                        metre=scene.metre or 1.0,
                        flicker=flicker.next(view, image, truth),
                        lpips=partial(perceptual.measure, index, image, truth),
                        dynamic=moving.of(index, known),
                        geometry=rendered.geometry,
                        known=known,
                        lidar=lidar,
                    )
                )
            for index, seen, alive, row in zip(indices, measured, n_alive, pool.map(measure, measured)):
                view = scene.test[index]
                share = None if seen.dynamic is None else float(seen.dynamic.mean())
                rows[index] = {
                    "view": view.name,
                    "time": scene.seconds_at(view.time),
                    **row,
                    "moving_share": share,
                    "n_alive": alive,
                }
                if save is not None and index in saved:
                    save(view.name, seen)
                if film is not None:
                    film(view.filmed_by, seen)

    per_image = [rows[index] for index in range(len(scene.test))]
    metrics: dict[str, float | str | None] = {**means(per_image), "lpips_note": perceptual.note}
    if metrics["ms_ssim"] is None:
        metrics["ms_ssim_note"] = f"MS-SSIM needs images of at least {MS_SSIM_SMALLEST_SIDE} px a side"
    metrics["moving_by"] = next(filter(None, map(moving.source, range(len(scene.test)))), None)
    counts = [row["n_alive"] for row in per_image]
    n_alive_mean = None if None in counts else float(np.mean(counts))
    return Evaluation(metrics, per_image, n_alive_mean, perceptual.weights)


def evaluate_with_images(model: Model, scene: Scene, cfg: Config, threads: int, folder: Path) -> Evaluation:
    """`evaluate`, with images in `folder` and, for a filmed scene with `evaluate.videos`, videos: one per test camera
    (films.held_out_films) and bullet_time.mp4 (films.write_bullet_time); of one clip films.write_clip_films."""
    save, renderer = picture_saver(folder, scene), Renderer(model, scene, cfg, engine_for(cfg.backend, threads))
    if not cfg.evaluate.videos or scene.frame_rate is None:
        found = evaluate(model, scene, cfg, threads, save)
        if cfg.evaluate.videos and scene.playback_rate is not None:
            write_clip_films(folder, renderer, scene.playback_rate)
        return found
    with held_out_films(folder, scene.playback_rate or scene.frame_rate) as film:
        found = evaluate(model, scene, cfg, threads, save, film)
    write_bullet_time(folder / "bullet_time.mp4", renderer)
    return found


def _geometry_of(
    renderer: Renderer, target: Target, known: GroundTruth | None, lidar: np.ndarray | None
) -> Geometry | None:
    """Rendered where there is something to compare it with, or a picture of it."""
    has_truth = known is not None and (known.depth is not None or known.flow is not None)
    if not has_truth and lidar is None and renderer.scene.capture != "drive":
        return None
    return renderer.geometry(target.camera, target.time, None if known is None else known.flow_dt)


def _foreground(target: Target, image: np.ndarray) -> np.ndarray:
    """(H, W) bool; of a scene whose images have alpha, an opaque view is all foreground."""
    return np.ones(image.shape[:2], bool) if target.alpha is None else target.alpha.numpy()[0] > 0


def _parallel_views(camera: Camera, threads: int, lpips_bytes: int) -> int:
    """How many views of this size (or smaller) to measure in parallel: one per thread within MEASURE_BYTES."""
    needed = camera.width * camera.height * (METRICS_BYTES_PER_PIXEL + lpips_bytes)
    return max(1, min(threads, MEASURE_BYTES // needed))
