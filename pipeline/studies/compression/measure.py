"""Size, speed and held-out PSNR of a model, pruned to several fractions and stored in several precisions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from torch import Tensor

from datasets.scene import Scene
from pipeline.config.random_streams import Stream, stream
from pipeline.config.schema import Config
from pipeline.evaluation.quick_evaluate import held_out_psnr, quick_evaluate
from pipeline.evaluation.speed import frames_per_second
from pipeline.model.model import Model
from pipeline.studies.compression.pruning import prune_by_sensitivity
from pipeline.studies.compression.retrain import retrain
from pipeline.studies.compression.storage import PRECISIONS, Precision, load_compressed, save_compressed
from pipeline.trained.open_run import TrainedRun
from pipeline.training.density.sensitivity_pruning import image_sensitivity
from pipeline.training.loop import Progress
from rasterizer import Rasterizer
from rasterizer.cores import thread_count


@dataclass(frozen=True)
class Point:
    """One compressed model, measured."""

    fraction: float  # of the Gaussians kept
    precision: Precision
    gaussians: int
    megabytes: float  # of the file
    psnr: float  # dB, mean over the test views
    fps: float  # frames a second, from 4D Gaussians to image


def pruned_models(run: TrainedRun, fractions: Sequence[float], share: float) -> dict[float, Model]:
    """The model of a run by the fraction of its Gaussians kept: all of them, then each of `fractions`.

    share: part of the schedule for which a pruned model is retrained.
    """
    cfg, scene = run.cfg, run.scene
    sensitivity = image_sensitivity(
        run.model,
        scene.train,
        scene,
        cfg,
        cfg.train.resolution_scale,
        stream(cfg.seed, Stream.SENSITIVITY),
        thread_count(cfg.threads),
    )
    return {
        fraction: pruned_model(run.model, sensitivity, scene, cfg, fraction, share) for fraction in (1.0, *fractions)
    }


def pruned_model(model: Model, sensitivity: Tensor, scene: Scene, cfg: Config, fraction: float, share: float) -> Model:
    """The `fraction` of the Gaussians with the largest `sensitivity` (N,), retrained; `model` stays as it is."""
    if fraction == 1:
        return model
    rasterizer = Rasterizer(threads=thread_count(cfg.threads))

    def evaluate_fn(state: Model, progress: Progress) -> dict:
        return quick_evaluate(state, scene, cfg, rasterizer)

    return retrain(prune_by_sensitivity(model, sensitivity, fraction), scene, cfg, share, evaluate_fn)


def measure(models: dict[float, Model], scene: Scene, cfg: Config) -> list[Point]:
    """Each model, by its fraction, in each precision. PSNR is of the model read back from its file.

    Frames a second are measured once for all precisions: a file is read back as float32.
    """
    threads, points = thread_count(cfg.threads), []
    fps = {fraction: frames_per_second(model, scene, cfg, threads)["fps_render"] for fraction, model in models.items()}
    with TemporaryDirectory() as folder:
        path = Path(folder) / "model.safetensors"
        for precision in PRECISIONS:
            for fraction, model in models.items():
                size = save_compressed(path, model, precision)
                psnr = float(held_out_psnr(load_compressed(path), scene, cfg, threads).mean())
                points.append(Point(fraction, precision, len(model), size / 1e6, psnr, fps[fraction]))
    return points


def smallest(points: Sequence[Point], max_loss: float) -> Point:
    """The smallest file within `max_loss` dB of the first point, the full model in float32."""
    return min((p for p in points if p.psnr >= points[0].psnr - max_loss), key=lambda p: p.megabytes)
