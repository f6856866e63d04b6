"""The stages of a run: what each reads, makes and depends on."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass

from datasets.files.atomic_write import atomic_file, write_json
from datasets.manifest import recorded
from pipeline.config.compose import Command
from pipeline.config.random_streams import Stream, stream
from pipeline.config.schema import Config
from pipeline.data.prepare import Prepared
from pipeline.data.stored_scene import to_dict
from pipeline.evaluation.evaluate import Evaluation, evaluate, evaluate_with_images
from pipeline.evaluation.moving_pixels import MovingPixels
from pipeline.evaluation.outlook import outlook, path_angles
from pipeline.evaluation.protocol import measured_by
from pipeline.evaluation.quick_evaluate import quick_evaluate
from pipeline.evaluation.renderer import Renderer
from pipeline.evaluation.rivals import AgainstRivals, Rivals
from pipeline.model.initialise import initialise
from pipeline.model.model import Model
from pipeline.model.ply import load_ply, save_ply
from pipeline.model.transformed import in_rotations
from pipeline.runs.provenance import engine_record, peak_memory_mb, reset_peak_memory
from pipeline.runs.run_folder import RunFolder, now, write_csv
from pipeline.stages.doubts import EarlyDoubts, doubt
from pipeline.stages.settle import changes, decide
from pipeline.stages.training_progress import TrainingProgress
from pipeline.terminal import interruption
from pipeline.training import checkpoint as checkpoints
from pipeline.training.density.densification import Densification
from pipeline.training.loop import TrainResult, train
from pipeline.training.reporting import Observer, Progress, Spent
from pipeline.view.live.feed import Feed, TrainingView
from pipeline.view.live.server import LiveServer, address_of
from pipeline.view.viewer import Shown, live_page, write_viewer
from rasterizer import engine_for
from rasterizer.bench.roofline import measure_rates
from rasterizer.cores import thread_count

TIMED_SECONDS = 30  # of training, from which on the machine's speed is measured: that takes a second
Log = Callable[[str], None]  # takes a line of text for the user


@dataclass(frozen=True)
class Job:
    """What a stage works with."""

    command: Command
    cfg: Config  # settled, but for the stages before `init`
    data: Prepared
    folder: RunFolder
    log: Log


@dataclass(frozen=True)
class Stage:
    name: str
    run: Callable[[Job], dict]  # returns what stages.json keeps of it
    outputs: tuple[str, ...]  # its files in the run folder; not every run has all of them
    code: tuple[str, ...]  # the code that makes its result, beside that of the stages before it


def prepare_points(job: Job) -> dict:
    """What structure from motion found, from its cache → sfm.json, sfm.png."""
    source = job.data.sfm_folder
    if source is None:
        return {}
    for path in (job.folder.sfm, job.folder.sfm_picture):
        with atomic_file(path) as temporary:
            shutil.copyfile(source / path.name, temporary)
    return job.data.cloud.summary() if job.data.cloud is not None else {}


def settle(job: Job) -> dict:
    """Scene and points → what validation decides about the model."""
    return decide(job.command, job.data, job.log)


def make_initial_model(job: Job) -> dict:
    """Scene and points → init.ply, scene.json; and in canonical.json how its coordinates come from the files'."""
    model = initialise(job.data.scene, job.cfg, stream(job.cfg.seed, Stream.INIT), job.data.cloud)
    with atomic_file(job.folder.init_ply) as temporary:
        save_ply(temporary, model)
    if not job.data.canonical.is_identity:
        write_json(job.folder.canonical, job.data.canonical.to_dict())
    write_json(job.folder.scene, to_dict(job.data.scene))
    return {"n_gaussians": len(model)}


def train_model(job: Job) -> dict:
    """init.ply → checkpoint.safetensors, error_vs_time.csv; goes on from the checkpoint if there is one.

    The seconds of the short trainings before it count as training.
    """
    cfg, scene, folder = job.cfg, job.data.scene, job.folder
    rasterizer = engine_for(cfg.backend, thread_count(cfg.threads))
    moving = MovingPixels(scene, cfg.train.resolution_scale)

    def evaluate_fn(model: Model, progress: Progress) -> dict:
        found = quick_evaluate(model, scene, cfg, rasterizer, moving)
        row = {"iteration": progress.iteration, **found, "peak_rss_mb": peak_memory_mb()}
        folder.log({"event": "evaluate", **row})
        return found

    reset_peak_memory()
    initial = load_ply(folder.init_ply)
    settled = folder.values_of("settle")
    before = Spent(settled["seconds"], settled["cpu_seconds"])
    progress = TrainingProgress(cfg.train.iterations, cfg.train.time_budget_s, cfg.out)

    def say(row: dict, line: str) -> None:
        folder.log(row)
        progress.say(line)

    with interruption.stops_noted(), progress, _live_view(cfg, job) as live:
        observers: list[Observer] = [progress, EarlyDoubts(len(initial), scene, cfg, rasterizer, say)]
        observers += [] if live is None else [live]
        result = train(initial, scene, cfg, folder, evaluate_fn, before, observers)
        if live is not None:
            live.see_last(result.model, result.iteration)
    return {
        "iterations": result.iteration,
        "train_seconds": result.spent.seconds,
        "train_cpu_seconds": result.spent.cpu_seconds,
        "n_gaussians": len(result.model),
        **_sizes(result),
        "cpu": _speed(thread_count(cfg.threads), result.spent.seconds),
        # The highest of this process and of the interrupted ones it continues, which log.jsonl holds.
        "peak_rss_mb": max([peak_memory_mb(), *(r["peak_rss_mb"] for r in folder.log_rows() if "peak_rss_mb" in r)]),
    }


def evaluate_model(job: Job) -> dict:
    """checkpoint.safetensors → metrics.json, per_image.csv, renders/."""
    cfg, scene, folder = job.cfg, job.data.scene, job.folder
    threads = thread_count(cfg.threads)
    saved = checkpoints.load(folder.checkpoint)
    model = in_rotations(saved.model)
    final = evaluate_with_images(model, scene, cfg, threads, folder.renders)
    best, best_metrics = None, None
    if cfg.evaluate.best_on_test and saved.best is not None and saved.best_model is not None:
        is_final = saved.best["iteration"] == saved.iteration
        best = final if is_final else evaluate(in_rotations(saved.best_model), scene, cfg, threads)
        best_metrics = {**best.metrics, "iteration": saved.best["iteration"]}

    against = Rivals(scene, cfg.train.resolution_scale).compare(
        Renderer(model, scene, cfg, engine_for(cfg.backend, threads))
    )
    settled, own_clip = folder.values_of("settle"), job.data.poses_estimated and scene.capture == "clip"
    write_csv(folder.per_image, _per_image(final, best))
    write_json(folder.metrics, {
        "scene": cfg.scene.name, "recipe": cfg.train.name, "model": cfg.ablation.name,
        "changes": changes(job.command, scene), "seed": cfg.seed, "capture": scene.capture, "date": now(),
        **measured_by(cfg, scene, final.lpips_weights), "images": "rendered",
        "data": recorded(cfg.scene.name, scene.source),
        "rendered_by": engine_record(cfg.backend),
        "final": final.metrics,
        "best_on_test": best_metrics,
        **({} if scene.test_split is None else {"test_split": scene.test_split}),
        "kind": asdict(model.kind), "decided": settled["decided"], "compared": settled["compared"],
        **({"outlook": _outlook(final, model, job.data)} if own_clip else {}),
        "rivals": asdict(against), "doubt": _doubt(job, len(model), against),
        "note": final.note(), "n_alive_mean": final.n_alive_mean, "n_test_views": len(scene.test),
        **folder.values_of("train"),
    })  # fmt: skip
    return {"psnr": final.metrics["psnr"]}


def write_page(job: Job) -> dict:
    """checkpoint.safetensors → viewer.html, the page that plays the trained model."""
    model = checkpoints.load_model(job.folder.checkpoint)
    shown = Shown(job.cfg.ablation.name, model, job.folder.values_of("evaluate")["psnr"])
    write_viewer(job.folder.viewer, [shown], job.data.scene, job.cfg)
    return {}


STAGES = (
    Stage("prepare", prepare_points, ("sfm.json", "sfm.png"), ("datasets", "pipeline/data")),
    Stage(
        "settle",
        settle,
        (),
        ("rasterizer", "pipeline/config", "pipeline/model", "pipeline/training", "pipeline/stages/decide.py"),
    ),
    Stage("init", make_initial_model, ("init.ply", "canonical.json", "scene.json"), ()),
    Stage("train", train_model, ("checkpoint.safetensors", "error_vs_time.csv"), ()),
    Stage("evaluate", evaluate_model, ("metrics.json", "per_image.csv", "renders"), ("pipeline/evaluation",)),
    Stage("page", write_page, ("viewer.html",), ("pipeline/view",)),
)
NAMES = tuple(stage.name for stage in STAGES)


@contextmanager
def _live_view(cfg: Config, job: Job) -> Iterator[TrainingView | None]:
    """Serves the run's page while it is trained, if `cfg.view` asks for it."""
    if not cfg.view:
        yield None
        return
    feed, page = Feed(), live_page(cfg.ablation.name, job.data.scene, cfg)
    with LiveServer(address_of(cfg.view_at, "view_at"), page, feed) as server:
        job.log(f"live view: {server.url}")
        yield TrainingView(feed, job.data.scene, cfg.train.iterations)


def _speed(threads: int, train_seconds: float) -> dict[str, float | None]:
    """Threads of training, and what one achieves at most, measured right after it; not for runs of seconds."""
    rates = measure_rates() if train_seconds >= TIMED_SECONDS else None
    own = (None, None) if rates is None else (rates.operations, rates.bytes)
    return {"threads": threads, "multiply_adds_per_s": own[0], "bytes_per_s": own[1]}


def _sizes(result: TrainResult) -> dict[str, float]:
    """In MB of 10⁶ bytes: the parameters alone, and with Adam's moments."""
    return {
        "model_mb": result.model.bytes / 1e6,
        "model_with_optimiser_mb": (result.model.bytes + result.optimiser_bytes) / 1e6,
    }


def _outlook(final: Evaluation, model: Model, data: Prepared) -> str:
    psnr = final.metrics["psnr"]
    assert isinstance(psnr, float)
    seconds = (data.scene.duration / data.canonical.time_scale) if model.kind.dims == 4 else None
    return outlook(path_angles(data.scene, seconds), psnr, dynamic=model.kind.dims == 4)


def _doubt(job: Job, left: int, against: AgainstRivals) -> str | None:
    initial = job.folder.values_of("init")["n_gaussians"]
    densified = any(row.get("event") == Densification.event for row in job.folder.log_rows())
    below_cap = initial < job.cfg.train.densify.max_gaussians
    return doubt(initial, left, densified and below_cap, against)


def _per_image(final: Evaluation, best: Evaluation | None) -> list[dict]:
    rows = [{"model": "final", **row} for row in final.per_image]
    return rows + [{"model": "best_on_test", **row} for row in (best.per_image if best else [])]
