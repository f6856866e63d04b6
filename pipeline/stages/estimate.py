"""Estimate of a run's disk, memory and time, before it starts.

Time is measured on this machine: decoding a few frames, the metrics of one image, and a few iterations with the maximum
number of Gaussians at each of the schedule's resolutions. A benchmark scene is rendered, and a run starts with fewer
Gaussians. Structure from motion is not included.
"""

from __future__ import annotations

import math
import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import torch

from datasets.scene import Scene
from datasets.source import Size, Source, open_source
from pipeline.config.schema import Config
from pipeline.config.train_schema import ResolutionStep
from pipeline.data.optical_flow import MEMORY_BYTES as FLOW_MEMORY_BYTES
from pipeline.data.optical_flow import measure_flow, measured_size
from pipeline.data.training_views import CACHE_LIMIT_BYTES, FLOW_BYTES, IMAGE_BYTES, area_average
from pipeline.evaluation.metrics import MeasuredView, measure
from pipeline.evaluation.quick_evaluate import EVAL_VIEWS
from pipeline.runs.provenance import memory_gb
from pipeline.stages.decide import COLOUR_SHARE, MOTION_SHARE, RESOLUTION, TIME_SHARE
from pipeline.training.objective.image_terms import flow_loss
from pipeline.training.schedule import early_evaluations
from rasterizer.bench.frame_time import time_frame, time_iteration
from rasterizer.bench.workloads import Workload, make_workload
from rasterizer.camera import Camera
from rasterizer.cores import thread_count

# float32 values per Gaussian of the full model in training: parameters, Adam's two moments and the best model so far,
# stored gradients (17) and statistics (6); for each view of a batch the gradient of the colour (9) and its state (40).
PARAMETERS = 161
FLOATS_PER_GAUSSIAN, FLOATS_PER_VIEW = PARAMETERS * 4 + 17 + 6, 9 + 40
CHECKPOINT_FLOATS = PARAMETERS * 4 + 4  # parameters, moments, best model; statistics
# Gaussians that blend into a pixel, in trained models: 45, 43 and 34 on ZJU-MoCap, counter and street; 6 to 14 on hook,
# lego, wheel, burst, lamp and still, whose objects are before a plain background.
BLENDED, BLENDED_OBJECT = 40.0, 11.0
BLENDED_BENCHMARK = 26.0  # of the benchmark's scene
# A training's time over that of its kernel calls, images and losses: densification, targets and the rest are 8 to 28 %
# (docs/kernel.md, where a training spends its time).
OTHER_WORK = 1.2
PROGRAM_MB = 600.0  # Python and torch
MAX_GAUSSIANS = 500_000  # assumed where train.densify.max_gaussians is higher
SPHERE_SHARE = 0.2  # of the sphere's Gaussians: those that cameras on one side see; the others are left out
TIMED_ITERATIONS = 3
LARGE_SCENE_BYTES = 1e9  # of decoded frames, above which a run logs its estimate


@dataclass(frozen=True)
class Estimate:
    gaussians: int  # assumed for time and memory
    cache_gb: float  # in scene.cache: decoded frames, shared by all runs of the scene, and flow that memory lacks
    run_gb: float  # the run folder
    memory_gb: float  # resident, without the page cache
    decode_seconds: float
    iteration_seconds: float
    train_seconds: float
    evaluate_seconds: float  # all evaluations

    def lines(self, cfg: Config) -> list[str]:
        """Lines of text: what the run needs, and what this machine has."""
        free = shutil.disk_usage(_existing(Path(cfg.scene.cache))).free / 1e9
        return [
            f"disk: {self.cache_gb:.1f} GB of frames and flow in {cfg.scene.cache}, {self.run_gb:.1f} GB in {cfg.out} "
            f"({free:.0f} GB free)",
            f"memory: about {self.memory_gb:.1f} GB without the page cache ({memory_gb():.0f} GB in this machine)",
            f"time: decoding {duration(self.decode_seconds)}, training {duration(self.train_seconds)} "
            f"({self.iteration_seconds:.2f} s per iteration at {self.gaussians:,} Gaussians), evaluations "
            f"{duration(self.evaluate_seconds)}; structure from motion not included",
        ]


def estimate(cfg: Config) -> Estimate:
    """Measure for a few seconds. Raises the errors of reading the scene."""
    return _of_source(cfg, open_source(cfg.scene, threads=cfg.threads))


def _of_source(cfg: Config, source: Source) -> Estimate:
    size, threads = source.size(), thread_count(cfg.threads)
    seconds = source.seconds_per_frame() * (size.train_views + size.test_views) / threads
    film = source.several_videos or source.poses == "of every frame"
    return _estimate(cfg, size, threads, film, source.stored_bytes, seconds)


def training_minutes(cfg: Config, scene: Scene) -> str:
    """A line for a scene that is read: how long its training will take on this machine."""
    camera, threads = scene.train[0].camera, thread_count(cfg.threads)
    size = Size(len(scene.train), len(scene.test), camera.width, camera.height)
    found = _estimate(cfg, size, threads, scene.capture in ("multi_view", "clip"))
    return (
        f"{len(scene.train)} training frames of {camera.width} x {camera.height}, {len(scene.test)} held out; training "
        f"will take about {duration(found.train_seconds)}, evaluations {duration(found.evaluate_seconds)}"
    )


def estimate_if_large(cfg: Config, log: Callable[[str], None]) -> Estimate | None:
    """`estimate` for a scene with more than LARGE_SCENE_BYTES of decoded frames; None for others.

    log: takes lines of text while a synthetic scene is rendered. What there is to say of other videos, reading them for
    the run says.
    """
    source = open_source(
        cfg.scene, threads=cfg.threads, log=log if cfg.scene.reader == "synthetic" else lambda line: None
    )
    return _of_source(cfg, source) if source.stored_bytes > LARGE_SCENE_BYTES else None


def _estimate(
    cfg: Config, size: Size, threads: int, film: bool, stored_bytes: int = 0, decode_seconds: float = 0.0
) -> Estimate:
    """film: of several cameras, or a clip. stored_bytes: of decoded frames in the cache; 0: images are in memory."""
    read, size = size, _scaled(size, cfg.train.resolution_scale)
    gaussians = min(cfg.train.densify.max_gaussians, MAX_GAUSSIANS)
    if cfg.scene.background_model == "sphere":
        gaussians += round(cfg.init.sphere_points * (SPHERE_SHARE if film else 1))
    flow = film and cfg.train.regularization.flow > 0
    stored = stored_bytes > 0
    blended = BLENDED if film or cfg.scene.background_model != "none" else BLENDED_OBJECT
    spent = partial(_iteration_seconds, cfg, blended=blended, threads=threads, flow=flow, stored=stored)
    iteration = spent(size, gaussians)
    train = cfg.train.iterations * iteration
    if cfg.train.time_budget_s is not None:
        train = min(train, cfg.train.time_budget_s)
    else:
        shared = MOTION_SHARE if cfg.train.select and cfg.ablation.shared_motion and not film else 0
        colour = COLOUR_SHARE if cfg.train.select and cfg.ablation.fourier_order else 0
        time_or_not = TIME_SHARE if cfg.scene.may_be_static else 0
        if choices := 2 * (time_or_not + shared + colour):  # an upper bound: shared motion at 100 pixels
            train += choices * cfg.train.iterations * spent(_scaled(size, RESOLUTION), gaussians)
        if flow:  # once for each view, by the choice of colour and by the training
            drawn = 2 * colour * cfg.train.iterations * cfg.train.batch
            train += _flow_seconds(read) * (read.train_views + min(drawn, read.train_views))
    workload = workload_of(gaussians, size, blended)
    view = time_frame(workload, threads, TIMED_ITERATIONS).forward.minimum / 1e3
    image = np.random.default_rng(0).random((size.height, size.width, 3), dtype=np.float32)
    started = time.perf_counter()
    measure(MeasuredView(image, image[::-1].copy()))
    measured = time.perf_counter() - started
    times = cfg.train.iterations // cfg.train.eval_every + len(early_evaluations(cfg.train.eval_every))
    quick = times * min(size.test_views, EVAL_VIEWS) * view
    final = (1 + cfg.evaluate.best_on_test) * size.test_views * (2 * view + measured / threads)
    pixels = size.width * size.height
    images = 0 if stored_bytes else (read.train_views + read.test_views) * 3 * read.width * read.height
    floats = min(size.train_views * pixels * (IMAGE_BYTES + flow * FLOW_BYTES), CACHE_LIMIT_BYTES)
    measured_pixels = math.prod(measured_size(read.width, read.height)) if flow else 0
    flows = size.train_views * 4 * measured_pixels  # two numbers in half precision
    held = min(flows, FLOW_MEMORY_BYTES)
    resident = 4 * gaussians * (FLOATS_PER_GAUSSIAN + FLOATS_PER_VIEW * cfg.train.batch) + images + floats + held
    return Estimate(
        gaussians,
        (stored_bytes + flows - held) / 1e9,
        4 * gaussians * (CHECKPOINT_FLOATS + PARAMETERS) / 1e9,
        resident / 1e9 + PROGRAM_MB / 1e3,
        decode_seconds,
        iteration,
        train,
        quick + final,
    )


def _iteration_seconds(
    cfg: Config, size: Size, gaussians: int, *, blended: float, threads: int, flow: bool, stored: bool
) -> float:
    """Mean over the schedule's resolutions. flow: rendered too, with depth. stored: images are read at each use."""
    seconds = begun = 0.0
    image = np.random.default_rng(0).integers(0, 256, (size.height, size.width, 3), dtype=np.uint8)
    for step in [*cfg.train.resolution_steps, ResolutionStep(until=1.0, scale=1.0)]:
        if step.until == begun:  # the last one of the schedule lasts to its end
            continue
        workload = workload_of(gaussians, _scaled(size, step.scale), blended)
        options = {"outputs": ("color", "alpha", "depth", "flow"), "flow_dt": 0.01 * workload.duration} if flow else {}
        sparse = cfg.train.optimiser == "sparse_adam"
        spent = time_iteration(workload, threads, TIMED_ITERATIONS, cfg.train.batch, sparse, **options)["iteration"]
        view = _seconds(partial(area_average, image, workload.camera)) if stored else 0.0
        view += _flow_loss_seconds(workload.camera) if flow else 0.0
        seconds += (step.until - begun) * (spent.minimum / 1e3 + cfg.train.batch * view)
        begun = step.until
    return OTHER_WORK * seconds


def _flow_seconds(size: Size) -> float:
    """To measure the optical flow of one image."""
    shape = (size.height, size.width, 3)
    images = np.random.default_rng(0).integers(0, 256, (2, *shape), dtype=np.uint8)
    return _seconds(partial(measure_flow, *images))


def _flow_loss_seconds(camera: Camera) -> float:
    flow = torch.zeros(2, camera.height, camera.width)
    return _seconds(partial(flow_loss, flow, flow, 1.0))


def _seconds(do: Callable[[], object]) -> float:
    """CPU time, since machines are shared."""
    started = time.process_time()
    do()
    return time.process_time() - started


def _scaled(size: Size, scale: float) -> Size:
    return replace(size, width=max(1, round(scale * size.width)), height=max(1, round(scale * size.height)))


def workload_of(gaussians: int, size: Size, blended: float) -> Workload:
    """The benchmark's forward-facing scene with this number of Gaussians and image size. They are as large as it takes
    that about `blended` of them blend into a pixel."""
    whole = make_workload("W2")
    rows = whole.gaussians.rows(torch.arange(gaussians) % len(whole.gaussians))
    area = len(whole.gaussians) / gaussians * blended / BLENDED_BENCHMARK
    rows.log_scale[:, :3] += 0.5 * math.log(area)
    return replace(whole, gaussians=rows, camera=whole.camera.resized(size.width, size.height))


def duration(seconds: float) -> str:
    """ "3 h 20 min", "12 min", "40 s"."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes // 60} h {minutes % 60:02d} min" if minutes >= 90 else f"{minutes} min"


def _existing(path: Path) -> Path:
    """The path itself, or its nearest existing parent."""
    path = path.resolve()
    return path if path.exists() else _existing(path.parent)
