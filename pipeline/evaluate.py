"""How good a model is on the test views (SPEC 5): image metrics, speed, and pictures to look at.

`evaluate` is what tables are made of; `quick_evaluate` is the cheap look that training takes now and then.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from datasets.scene import Scene
from pipeline import lpips
from pipeline.config import Config
from pipeline.metrics import METRICS, MS_SSIM_NOTE, mean, measure, psnr
from pipeline.model import Model
from pipeline.run_folder import replacing
from pipeline.views import Target, target_of
from rasterizer import Frame, Request
from rasterizer.gaussians import Gaussians
from rasterizer.loss import l1_ssim

DIFFERENCE_GAIN = 4  # a difference image shows |render - truth| so many times brighter, clipped at white
LPIPS_NETS = ("alex", "vgg")

SaveImages = Callable[[str, np.ndarray, np.ndarray], None]  # (view name, render, truth), images (H, W, 3) in [0, 1]


@dataclass(frozen=True)
class Evaluation:
    """Means over the test views, and what they are means of."""

    metrics: dict[str, float | str | None]  # METRICS, lpips_*, fps_*; *_note where a number is missing
    per_image: list[dict[str, float | str | None]]  # view, time, METRICS, lpips_*, n_alive
    n_alive_mean: float  # Gaussians with p(t) >= 0.05, mean over the views

    def note(self) -> str | None:
        """Why numbers are missing, if any is."""
        notes = [value for name, value in self.metrics.items() if name.endswith("_note") and value]
        return "; ".join(notes) or None


def evaluate(model: Model, scene: Scene, cfg: Config, threads: int, save: SaveImages | None = None) -> Evaluation:
    """Measure `model` on every test view of `scene`, at the size training ended with.

    Renders are clamped to [0, 1] and not rounded to 8 bits. save: called in the order of the views with those that
    `cfg.evaluate.renders` picks. Raises ValueError for a model that is not finite.
    """
    if broken := model.first_non_finite():  # a render would not show it: max(0, NaN) is 0
        raise ValueError(f"model to evaluate: expected finite values, found NaN or Inf in {broken[0]} of Gaussian "
                         f"{broken[1]}")
    networks, lpips_note = _lpips_networks(cfg, scene)
    frame, gaussians = Frame(threads=threads), model.gaussians()
    shown = set(_spread(len(scene.test), cfg.evaluate.renders))
    rows: list[dict] = []

    def measured(job: tuple[np.ndarray, np.ndarray]) -> dict[str, float | None]:
        distances = {f"lpips_{net}": network(*job) if network else None for net, network in networks.items()}
        return {**measure(*job), **distances}

    # Rendering takes all threads for milliseconds, measuring one for a quarter of a second: a few views at a time.
    with ThreadPoolExecutor(threads) as pool:
        for first in range(0, len(scene.test), threads):
            jobs, alive = [], []
            for view in scene.test[first : first + threads]:
                target = target_of(view, cfg.train.resolution_scale)
                jobs.append((_rendered(frame, gaussians, target, scene, cfg), _channels_last(target)))
                alive.append(frame.alive)
            for view, job, n_alive, row in zip(scene.test[first:], jobs, alive, pool.map(measured, jobs)):
                rows.append({"view": view.name, "time": view.time, **row, "n_alive": n_alive})
                if save is not None and len(rows) - 1 in shown:
                    save(view.name, *job)

    metrics = {name: mean(rows, name) for name in (*METRICS, *(f"lpips_{net}" for net in LPIPS_NETS))}
    metrics["lpips_note"] = lpips_note
    if metrics["ms_ssim"] is None:
        metrics["ms_ssim_note"] = MS_SSIM_NOTE
    metrics.update(frames_per_second(model, scene, cfg, threads))
    return Evaluation(metrics, rows, float(np.mean([row["n_alive"] for row in rows])))


def quick_evaluate(model: Model, scene: Scene, cfg: Config, frame: Frame) -> dict[str, float]:
    """{psnr, ssim, test_loss} over all test views, in about the time it takes to render them.

    Of the full-size image, also while training is at a coarse resolution: it is the one that is wanted in the end,
    and the only one whose numbers can be compared along the run. SSIM is the loss's (zero padding at the border, as
    3DGS), which differs from metrics.ssim in the third decimal.
    """
    gaussians, rows = model.gaussians(), []
    for view in scene.test:
        target = target_of(view, cfg.train.resolution_scale)
        image = frame.render(gaussians, _request(target, scene, cfg), differentiable=False).color.clamp_(0.0, 1.0)
        loss, _, ssim, _ = l1_ssim(image, target.image, cfg.train.ssim_weight, frame.threads)
        rows.append({"psnr": psnr(image.numpy(), target.image.numpy()), "ssim": ssim, "test_loss": loss})
    return {name: mean(rows, name) for name in ("psnr", "ssim", "test_loss")}


def frames_per_second(model: Model, scene: Scene, cfg: Config, threads: int) -> dict[str, float]:
    """{fps_render, fps_raster} over the test views, the fastest of `evaluate.speed_repeats` passes each.

    fps_render: everything from the 4D Gaussians to the image: slicing, projecting, sorting, binning, blending.
    fps_raster: blending alone, by the kernel's own clock.
    """
    frame, gaussians = Frame(threads=threads), model.gaussians()
    requests = [_request(target_of(view, cfg.train.resolution_scale), scene, cfg) for view in scene.test]
    whole, blend = [], []
    for _ in range(cfg.evaluate.speed_repeats):
        spent = 0.0
        started = time.perf_counter()
        for request in requests:
            frame.render(gaussians, request, differentiable=False)
            spent += frame.stage_ms["blend"] / 1000.0
        whole.append(time.perf_counter() - started)
        blend.append(spent)
    return {"fps_raster": len(requests) / max(min(blend), 1e-9), "fps_render": len(requests) / min(whole)}


def png_saver(folder: Path) -> SaveImages:
    """Write <view>_render.png, <view>_truth.png and <view>_difference.png, slashes of the view's name as _.

    The difference is |render - truth| × DIFFERENCE_GAIN, clipped: black where they agree.
    """
    folder.mkdir(exist_ok=True)

    def save(name: str, image: np.ndarray, truth: np.ndarray) -> None:
        difference = np.clip(np.abs(image - truth) * DIFFERENCE_GAIN, 0.0, 1.0)
        for kind, picture in (("render", image), ("truth", truth), ("difference", difference)):
            with replacing(folder / f"{name.replace('/', '_')}_{kind}.png") as temporary:
                Image.fromarray(np.round(picture * 255.0).astype(np.uint8)).save(temporary)

    return save


def _rendered(frame: Frame, gaussians: Gaussians, target: Target, scene: Scene, cfg: Config) -> np.ndarray:
    """(H, W, 3) float32 in [0, 1]."""
    image = frame.render(gaussians, _request(target, scene, cfg), differentiable=False).color
    return np.clip(image.numpy().transpose(1, 2, 0), 0.0, 1.0)


def _channels_last(target: Target) -> np.ndarray:
    return target.image.numpy().transpose(1, 2, 0)


def _request(target: Target, scene: Scene, cfg: Config) -> Request:
    return Request(target.camera, time=target.time, duration=scene.duration, background=scene.background,
                   near=cfg.scene.near)


def _lpips_networks(cfg: Config, scene: Scene) -> tuple[dict[str, lpips.Lpips | None], str | None]:
    """The networks there are weights for, and why the others are None."""
    networks: dict[str, lpips.Lpips | None] = dict.fromkeys(LPIPS_NETS)
    if not cfg.evaluate.lpips:
        return networks, "not measured: evaluate.lpips=false"
    side = round(min(scene.test[0].image.shape[:2]) * cfg.train.resolution_scale)
    if side < lpips.SMALLEST_SIDE:
        return networks, f"LPIPS needs images of {lpips.SMALLEST_SIDE} px a side at least"
    note = None
    for net in LPIPS_NETS:
        try:
            networks[net] = lpips.load(net)
        except lpips.LpipsUnavailable as error:
            note = note or str(error)
    return networks, note


def _spread(count: int, wanted: int) -> Iterator[int]:
    """`wanted` of `count` indices, evenly from first to last; -1 or too many: all."""
    if wanted < 0 or wanted >= count:
        return iter(range(count))
    return iter(np.unique(np.linspace(0, count - 1, wanted).round().astype(int)).tolist())
