"""Compression of a trained model: PSNR against file size and speed, pruned and in fewer bits.

Keeps the Gaussians with the largest image sensitivity (80 % to 40 %), retrains them for the last 60 % of the run's
schedule, stores each model as float32, float16 and int8, and measures it on the run's test views. Writes
compression.md, and the smallest model within 0.1 dB of the full one (compression.safetensors).
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import torch

from datasets.scene import Scene
from pipeline.config.schema import Config
from pipeline.evaluation.quick_evaluate import held_out_psnr
from pipeline.evaluation.renderer import frames_per_second
from pipeline.model.model import Model
from pipeline.studies.common import StudyParser, made_by, markdown_table, write_results
from pipeline.studies.compression.pruning import pruned_models
from pipeline.studies.compression.storage import PRECISIONS, Precision, load_compressed, save_compressed
from pipeline.terminal.command_line import command, log
from pipeline.trained.open_run import open_run
from rasterizer.cores import thread_count

NAME = "compression"
FRACTIONS = (0.8, 0.7, 0.6, 0.5, 0.4)  # of the Gaussians kept
RETRAINED = 0.6  # part of the schedule, its last, for which pruned models are retrained
MAX_LOSS = 0.1  # dB, of the smallest model
HEADER = ("Gaussians", "stored as", "MB", "MB / full", "FPS", "FPS / full", "PSNR, dB", "Δ PSNR, dB")


@dataclass(frozen=True)
class Point:
    fraction: float  # of the Gaussians kept
    precision: Precision
    gaussians: int
    megabytes: float  # of the file
    psnr: float  # dB, mean over the test views
    fps: float  # frames a second, from 4D Gaussians to image


def measure(models: dict[float, Model], scene: Scene, cfg: Config) -> list[Point]:
    """Each model, by its fraction, in each precision. PSNR is of the model read back from its file.

    Frames a second are measured once for all precisions: a file is read back as float32.
    """
    threads, points = thread_count(cfg.threads), []
    fps = {fraction: frames_per_second(model, scene, cfg, threads)[0] for fraction, model in models.items()}
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


def markdown(points: Sequence[Point], chosen: Point, heading: str) -> str:
    """One row for each point, relative to the full model, which is first; `chosen` is in bold."""
    full, rows = points[0], []
    for p in points:
        row = (
            f"{p.fraction:.0%}, {p.gaussians:,}",
            p.precision,
            f"{p.megabytes:.2f}",
            f"{p.megabytes / full.megabytes:.2f}",
            f"{p.fps:.0f}",
            f"{p.fps / full.fps:.2f}",
            f"{p.psnr:.2f}",
            f"{p.psnr - full.psnr:+.2f}",
        )
        rows.append([f"**{cell}**" if p is chosen else cell for cell in row])
    return (
        f"### PSNR against size and speed\n\n{heading}\n\n{markdown_table(HEADER, rows)}\n\n"
        "- Bold: the smallest file within the allowed loss of PSNR. Means and shared trajectories are always float32; "
        "int8 covers the SH coefficients but the first, and the rest is float16. Pruned models are retrained for the "
        f"last {RETRAINED:.0%} of the schedule.\n"
    )


@command
def main(arguments: list[str]) -> int:
    parser = StudyParser(NAME, __doc__)
    parser.add_argument("run", type=Path, metavar="RUN", help="folder of a finished run")
    options = parser.parse_args(arguments)
    torch.set_num_threads(1)  # the kernel has threads of its own; torch's rounding depends on their number
    run = open_run(options.run, log)
    cfg = run.cfg
    models = pruned_models(run, FRACTIONS, RETRAINED)
    points = measure(models, run.scene, cfg)
    chosen = smallest(points, MAX_LOSS)
    title = f"{cfg.scene.name}, {cfg.ablation.name}, {cfg.train.name}, seed {cfg.seed}"
    table = markdown(points, chosen, f"{title}. {made_by(NAME, arguments)}.")
    save = partial(save_compressed, model=models[chosen.fraction], precision=chosen.precision)
    write_results(options.out, NAME, table, {"safetensors": save})
    return 0


if __name__ == "__main__":
    sys.exit(main())
