"""How good a model is on the test views (docs/method.md 4): image metrics, flicker, speed, pictures and videos.

`evaluate` is what tables are made of; `quick_evaluate` is the cheap look that training takes now and then.

What is measured where: every metric on every test view, except LPIPS-VGG in large scenes (perceptual.py); flicker on
every pair of consecutive frames. At 1352 × 1014 pixels a view takes 3 s of one core, LPIPS-Alex included. The cheap
look takes `train.eval_views` views, the speed SPEED_VIEWS; both spread evenly, from the first to the last.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image
from torch import Tensor

from datasets.files.atomic_write import atomic_file
from datasets.scene import Scene, View
from pipeline.config.schema import Config
from pipeline.data.frame_order import film_order
from pipeline.data.training_views import camera_at, spread, target_of
from pipeline.evaluation.camera_path import FRAME_RATE, bullet_time, ellipse_among, median_depth
from pipeline.evaluation.films import HeldOutFilms, video
from pipeline.evaluation.flicker import FlickerMeter, mean_flicker
from pipeline.evaluation.metrics import METRICS, MS_SSIM_NOTE, mean, measure, psnr
from pipeline.evaluation.perceptual import Perceptual
from pipeline.model.model import Model
from pipeline.model.render import render_image
from rasterizer import Camera, Rasterizer, Request
from rasterizer.loss import l1_ssim

DIFFERENCE_GAIN = 4  # a difference image shows |render - truth| so many times brighter, clipped at white
METRICS_BYTES_A_PIXEL = 400  # memory while a view is measured, its images and LPIPS-Alex included; VGG has its own
MEASURE_BYTES = 4 * 1024**3  # for the views that are measured side by side
SPEED_VIEWS = 30  # at most: a pass takes time, and the views of a film resemble each other

SaveImages = Callable[[str, np.ndarray, np.ndarray], None]  # (view name, render, truth), images (H, W, 3) in [0, 1]


@dataclass(frozen=True)
class Evaluation:
    """Means over the test views, and what they are means of."""

    metrics: dict[str, float | str | None]  # METRICS, lpips_*, flicker, fps_*; *_note where a number is missing
    per_image: list[dict[str, float | str | None]]  # view, time, METRICS, lpips_*, flicker, n_alive
    n_alive_mean: float  # Gaussians with p(t) >= 0.05, mean over the views

    def note(self) -> str | None:
        """Why numbers are missing, if any is."""
        notes = [value for name, value in self.metrics.items() if name.endswith("_note") and value]
        return "; ".join(notes) or None


@dataclass(frozen=True)
class Renderer:
    """`model` in the light of `scene`: what turns a camera and a time into an image."""

    model: Model
    scene: Scene
    cfg: Config
    frame: Rasterizer

    def tensor(self, camera: Camera, moment: float) -> Tensor:
        """(3, H, W), not clamped. moment: in the scene's unit of time."""
        near = self.cfg.scene.near * self.scene.unit
        return render_image(
            self.frame,
            self.model,
            Request(camera, time=moment, duration=self.scene.duration, background=self.scene.background, near=near),
        )

    def image(self, camera: Camera, moment: float) -> np.ndarray:
        """(H, W, 3) float32 in [0, 1], not rounded to 8 bits."""
        return np.clip(self.tensor(camera, moment).numpy().transpose(1, 2, 0), 0.0, 1.0)


def evaluate(
    model: Model,
    scene: Scene,
    cfg: Config,
    threads: int,
    save: SaveImages | None = None,
    film: SaveImages | None = None,
) -> Evaluation:
    """Measure `model` on every test view of `scene`, at the size training ended with.

    Renders are clamped to [0, 1] and not rounded to 8 bits. save: called with those views that
    `cfg.evaluate.renders` picks. film: called with all of them. Both in the order of the views; where cameras filmed,
    in film order. Raises ValueError for a model that is not finite.
    """
    if broken := model.first_non_finite():  # a render would not show it: max(0, NaN) is 0
        raise ValueError(
            f"model to evaluate: expected finite values, found NaN or Inf in {broken[0]} of Gaussian {broken[1]}"
        )
    perceptual = Perceptual(cfg, scene)
    renderer, flickering = Renderer(model, scene, cfg, Rasterizer(threads=threads)), FlickerMeter(scene.frame_rate)
    shown = set(spread(len(scene.test), cfg.evaluate.renders))
    rows: dict[int, dict] = {}  # by index of the view

    def measured(index: int, image: np.ndarray, truth: np.ndarray) -> dict[str, float | None]:
        return {**measure(image, truth), **perceptual.measure(index, image, truth)}

    # Rendering takes all threads for milliseconds, measuring one for a quarter of a second: a few views at a time.
    order = film_order(scene.test, scene.frame_rate)
    at_once = _at_once(scene.test[0].camera, threads, perceptual.bytes_a_pixel)
    with ThreadPoolExecutor(at_once) as pool:
        for first in range(0, len(order), at_once):
            some = order[first : first + at_once]
            jobs, alive = [], []
            for view in (scene.test[index] for index in some):
                target = target_of(view, cfg.train.resolution_scale)
                jobs.append((renderer.image(target.camera, view.time), target.image.numpy().transpose(1, 2, 0)))
                alive.append(renderer.frame.alive)
            for index, job, n_alive, row in zip(some, jobs, alive, pool.map(measured, some, *zip(*jobs))):
                view = scene.test[index]
                rows[index] = {
                    "view": view.name,
                    "time": view.time,
                    **row,
                    "flicker": flickering.next(view, *job),
                    "n_alive": n_alive,
                }
                if save is not None and index in shown:
                    save(view.name, *job)
                if film is not None:
                    film(view.name, *job)

    per_image = [rows[index] for index in range(len(scene.test))]
    metrics = {**{name: mean(per_image, name) for name in METRICS}, **perceptual.means(per_image)}
    if metrics["ms_ssim"] is None:
        metrics["ms_ssim_note"] = MS_SSIM_NOTE
    metrics["flicker"] = mean_flicker([row["flicker"] for row in per_image])
    metrics.update(frames_per_second(model, scene, cfg, threads))
    return Evaluation(metrics, per_image, float(np.mean([row["n_alive"] for row in per_image])))


def evaluate_and_show(model: Model, scene: Scene, cfg: Config, threads: int, folder: Path) -> Evaluation:
    """`evaluate`, with pictures in `folder` and, where a held-out camera filmed, videos (`evaluate.videos`).

    Videos: see video.HeldOutFilms, and bullet_time.mp4 along camera_path's ellipse.
    """
    save = png_saver(folder)
    if not cfg.evaluate.videos or scene.frame_rate is None:
        return evaluate(model, scene, cfg, threads, save)
    with HeldOutFilms(folder, scene.shown_rate or scene.frame_rate) as film:
        found = evaluate(model, scene, cfg, threads, save, film)
    write_bullet_time(folder / "bullet_time.mp4", Renderer(model, scene, cfg, Rasterizer(threads=threads)))
    return found


def quick_evaluate(model: Model, scene: Scene, cfg: Config, frame: Rasterizer) -> dict[str, float]:
    """{psnr, ssim, test_loss} over `train.eval_views` test views, and train_psnr over as many training views, in about
    the time it takes to render them.

    Of the full-size image, also while training is at a coarse resolution: it is the one that is wanted in the end,
    and the only one whose numbers can be compared along the run. SSIM is the loss's (zero padding at the border, as
    3DGS), which differs from metrics.ssim in the third decimal.
    """
    renderer = Renderer(model, scene, cfg, frame)

    def means(views: Sequence[View]) -> dict[str, float]:
        rows = []
        for view in _some(views, cfg.train.eval_views):
            target = target_of(view, cfg.train.resolution_scale)
            image = renderer.tensor(target.camera, view.time).clamp_(0.0, 1.0)
            loss, _, ssim, _ = l1_ssim(image, target.image, cfg.train.ssim_weight, frame.threads)
            rows.append({"psnr": psnr(image.numpy(), target.image.numpy()), "ssim": ssim, "test_loss": loss})
        return {name: mean(rows, name) for name in ("psnr", "ssim", "test_loss")}

    return {**means(scene.test), "train_psnr": means(scene.train)["psnr"]}


def held_out_psnr(model: Model, scene: Scene, cfg: Config, threads: int) -> np.ndarray:
    """(test views,) dB, as metrics.json's, at the size training ended with; nothing else is measured."""
    renderer, found = Renderer(model, scene, cfg, Rasterizer(threads=threads)), []
    for view in scene.test:
        target = target_of(view, cfg.train.resolution_scale)
        found.append(psnr(renderer.image(target.camera, view.time), target.image.numpy().transpose(1, 2, 0)))
    return np.array(found)


def frames_per_second(model: Model, scene: Scene, cfg: Config, threads: int) -> dict[str, float]:
    """{fps_render, fps_raster} over SPEED_VIEWS test views, the fastest of `evaluate.speed_repeats` passes each.

    fps_render: everything from the 4D Gaussians to the image: slicing, projecting, sorting, binning, blending, and the
    environment behind them. fps_raster: blending alone, by the kernel's own clock.
    """
    renderer = Renderer(model, scene, cfg, Rasterizer(threads=threads))
    shots = [(camera_at(view.camera, cfg.train.resolution_scale), view.time) for view in _some(scene.test, SPEED_VIEWS)]
    whole, blend = [], []
    for _ in range(cfg.evaluate.speed_repeats):
        spent = 0.0
        started = time.perf_counter()
        for shot in shots:
            renderer.tensor(*shot)
            spent += renderer.frame.stage_ms["blend"] / 1000.0
        whole.append(time.perf_counter() - started)
        blend.append(spent)
    return {"fps_raster": len(shots) / max(min(blend), 1e-9), "fps_render": len(shots) / min(whole)}


def write_bullet_time(path: Path, renderer: Renderer) -> None:
    """A video along camera_path's ellipse among the training cameras, through the lens of the first test camera."""
    scene, scale = renderer.scene, renderer.cfg.train.resolution_scale
    cameras, lens = [view.camera for view in scene.train], camera_at(scene.test[0].camera, scale)
    points, sphere = renderer.model.parameters["mean"][:, :3], renderer.model.sphere
    depth = median_depth((points if sphere is None else points[~sphere]).numpy(), lens)
    ellipse = ellipse_among(cameras, usual_depth=depth or scene.extent)
    with video(path, lens.width, lens.height, FRAME_RATE) as send:
        for shot in bullet_time(ellipse, lens, scene.time_start, scene.duration):
            send(renderer.image(shot.camera, shot.time))


def png_saver(folder: Path) -> SaveImages:
    """Write <view>_render.png, <view>_truth.png and <view>_difference.png, slashes of the view's name as _.

    The difference is |render - truth| × DIFFERENCE_GAIN, clipped: black where they agree.
    """
    folder.mkdir(exist_ok=True)

    def save(name: str, image: np.ndarray, truth: np.ndarray) -> None:
        difference = np.clip(np.abs(image - truth) * DIFFERENCE_GAIN, 0.0, 1.0)
        for kind, picture in (("render", image), ("truth", truth), ("difference", difference)):
            with atomic_file(folder / f"{name.replace('/', '_')}_{kind}.png") as temporary:
                Image.fromarray(np.round(picture * 255.0).astype(np.uint8)).save(temporary)

    return save


def _at_once(camera: Camera, threads: int, lpips_bytes: int) -> int:
    """How many views of this size (or smaller) to measure side by side: a thread each, while memory lasts."""
    needed = camera.width * camera.height * (METRICS_BYTES_A_PIXEL + lpips_bytes)
    return max(1, min(threads, MEASURE_BYTES // needed))


def _some(views: Sequence[View], wanted: int) -> list[View]:
    return [views[index] for index in spread(len(views), wanted)]
