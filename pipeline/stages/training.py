"""Stage train: from the initial model to the checkpoint; seen in a browser meanwhile if asked for."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from datasets import Scene
from pipeline.config.schema import Config
from pipeline.data.prepared import Prepared
from pipeline.evaluation.lifetimes import lifetimes
from pipeline.evaluation.motion.moving_pixels import MovingPixels
from pipeline.evaluation.quick_evaluate import quick_evaluate
from pipeline.model.model import Model
from pipeline.model.ply import load_ply
from pipeline.runs.provenance import peak_memory_mb, reset_peak_memory
from pipeline.runs.run_folder import RunFolder
from pipeline.stages.decisions import as_decided, motion_of, time_colour_of
from pipeline.stages.stage import Log
from pipeline.training.loop import Progress, TrainResult, train
from pipeline.view.live.feed import Feed, TrainingView
from pipeline.view.live.server import LiveServer, address_of
from pipeline.view.viewer import live_page
from rasterizer import Rasterizer
from rasterizer.cores import thread_count

FEW_LEFT = 0.01  # of the initial Gaussians; 48 of 20,000 were left where all poses were wrong


def few_left(left: int, initial: int) -> str | None:
    """A warning where training removed nearly all Gaussians: no image then agrees with another."""
    if left >= FEW_LEFT * initial:
        return None
    return f"{left} of {initial} initial Gaussians are left: the poses or the times may not be those of the images"


def train_model(cfg: Config, data: Prepared, folder: RunFolder, log: Log) -> dict:
    """init.ply → checkpoint.safetensors, error_vs_time.csv; goes on from the checkpoint if there is one.

    The seconds of select_motion and select_time_colour count as training.
    """
    scene, cfg = data.scene, as_decided(cfg, data, folder)
    rasterizer = Rasterizer(threads=thread_count(cfg.threads))
    moving = MovingPixels(scene, cfg.train.resolution_scale)

    def evaluate_fn(model: Model, progress: Progress) -> dict:
        found = quick_evaluate(model, scene, cfg, rasterizer, moving)
        folder.log(
            {
                "event": "evaluate",
                "iteration": progress.iteration,
                **found,
                "lifetimes": lifetimes(model, scene),
                "peak_rss_mb": peak_memory_mb(),
            }
        )
        if watcher is not None:
            watcher.held_out = found["psnr"]
        return found

    reset_peak_memory()
    decisions = [decision.seconds for decision in (motion_of(folder), time_colour_of(folder)) if decision]
    initial = load_ply(folder.init_ply)
    count = len(initial)
    with _live_view(cfg, scene, log) as watcher:
        result = train(initial, scene, cfg, folder, evaluate_fn, start_seconds=sum(decisions), watcher=watcher)
        if watcher is not None:
            watcher.see_last(result.model, result.iteration)
    if warning := few_left(len(result.model), count):
        log(warning)
    return {
        "iterations": result.iteration,
        "train_seconds": result.train_seconds,
        "n_gaussians": len(result.model),
        **_sizes(result),
        "peak_rss_mb": _peak_memory_mb(folder),
    }


@contextmanager
def _live_view(cfg: Config, scene: Scene, log: Log) -> Iterator[TrainingView | None]:
    """Serves the run's page while it is trained, if `cfg.view` asks for it."""
    if not cfg.view:
        yield None
        return
    feed = Feed()
    with LiveServer(address_of(cfg.view_at, "view_at"), live_page(cfg.ablation.name, scene, cfg), feed) as server:
        log(f"live view: {server.url}")
        yield TrainingView(feed, scene, cfg.train.iterations)


def _sizes(result: TrainResult) -> dict[str, float]:
    """In MB of 10⁶ bytes: the parameters alone, and with Adam's moments."""
    return {
        "model_mb": result.model.bytes / 1e6,
        "model_with_optimiser_mb": (result.model.bytes + result.optimiser_bytes) / 1e6,
    }


def _peak_memory_mb(folder: RunFolder) -> float:
    """The highest of this process and of the interrupted ones it continues, which log.jsonl holds."""
    return max([peak_memory_mb(), *(row["peak_rss_mb"] for row in folder.log_rows() if "peak_rss_mb" in row)])
