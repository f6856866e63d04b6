"""Compression of a trained model: PSNR against file size and speed, pruned and in fewer bits.

Keeps the Gaussians with the largest image sensitivity (each of --fractions), retrains them for the last --retrain of
the run's schedule, stores each model as float32, float16 and int8, and measures it on the run's test views. Writes
compression.md, compression.svg, and the smallest model within --loss dB of the full one (compression.safetensors).
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import torch

from datasets.scene import Scene
from pipeline.config.schema import Config
from pipeline.evaluation.quick_evaluate import held_out_psnr
from pipeline.evaluation.renderer import frames_per_second
from pipeline.model.model import Model
from pipeline.presentation.theme import LIGHT
from pipeline.studies.common import StudyParser, made_by, markdown_table, svg_figure, svg_style, svg_text, write_results
from pipeline.studies.compression.pruning import pruned_models
from pipeline.studies.compression.storage import PRECISIONS, Precision, load_compressed, save_compressed
from pipeline.terminal.command_line import command, log
from pipeline.trained.open_run import open_run
from rasterizer.cores import thread_count

NAME = "compression"
FRACTIONS = (0.8, 0.7, 0.6, 0.5, 0.4)
HEADER = ("Gaussians", "stored as", "MB", "MB / full", "FPS", "FPS / full", "PSNR, dB", "Δ PSNR, dB")
_MARGINS = {"left": 0.07, "right": 0.985, "bottom": 0.14, "top": 0.86, "wspace": 0.08}


@dataclass(frozen=True)
class Point:
    """One compressed model, measured."""

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


def markdown(points: Sequence[Point], chosen: Point, heading: str, share: float) -> str:
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
        "- Bold: the smallest file within the allowed loss of PSNR. Means are always float32; int8 covers the SH "
        "coefficients but the first, and the rest is float16. Pruned models are retrained for the last "
        f"{share:.0%} of the schedule.\n"
    )


def draw(points: Sequence[Point], title: str) -> str:
    """SVG text: PSNR against megabytes and frames a second, a line for each precision."""
    with svg_style(NAME):
        figure = svg_figure(9.6, 3.6)
        panels = figure.subplots(1, 2, sharey=True, gridspec_kw=_MARGINS)
        for axis, name, label in zip(panels, ("megabytes", "fps"), ("MB on disk", "frames a second"), strict=True):
            for precision, colour in zip(PRECISIONS, LIGHT.ablations):
                line = [(getattr(p, name), p.psnr, p.fraction) for p in points if p.precision == precision]
                axis.plot([x for x, *_ in line], [y for _, y, _ in line], "o-", ms=4, color=colour, label=precision)
            for x, y, fraction in line:  # of the last precision
                axis.annotate(f"{fraction:.0%}", (x, y), xytext=(3, -9), textcoords="offset points", fontsize=7)
            axis.set(xlabel=label)
            axis.grid(color=LIGHT.faint, lw=0.7)
        panels[0].set_ylabel("PSNR, dB, test views")
        panels[0].legend(frameon=False)
        return svg_text(figure, title)


@command
def main(arguments: list[str]) -> int:
    parser = StudyParser(NAME, __doc__)
    parser.add_argument("run", type=Path, metavar="RUN", help="folder of a finished run")
    loss, part = "allowed loss of PSNR, dB", "part of the schedule for which pruned models are retrained, 0 to 1"
    parser.add_argument("--loss", type=float, default=0.1, metavar="DB", help=f"{loss} (default: %(default)s)")
    parser.add_argument("--retrain", type=float, default=0.6, metavar="SHARE", help=f"{part} (default: %(default)s)")
    shown = " ".join(map(str, FRACTIONS))
    parts = f"fractions of the Gaussians to keep, besides all of them (default: {shown})"
    parser.add_argument("--fractions", type=float, nargs="+", default=FRACTIONS, metavar="F", help=parts)
    options = parser.parse_args(arguments)
    parser.require(0 <= options.loss < math.inf, "--loss", "dB, 0 or more", f"{options.loss:g}")
    parser.require(0 <= options.retrain <= 1, "--retrain", "a part of the schedule, 0 to 1", options.retrain)
    for fraction in options.fractions:
        parser.require(0 < fraction < 1, "--fractions", "parts of the Gaussians, above 0 and below 1", f"{fraction:g}")
    torch.set_num_threads(1)  # the kernel has threads of its own; torch's rounding depends on their number
    run = open_run(options.run, log)
    cfg = run.cfg
    models = pruned_models(run, options.fractions, options.retrain)
    points = measure(models, run.scene, cfg)
    chosen = smallest(points, options.loss)
    title = f"{cfg.scene.name}, {cfg.ablation.name}, {cfg.train.name}, seed {cfg.seed}"
    table = markdown(points, chosen, f"{title}. {made_by(NAME, arguments)}.", options.retrain)
    written = write_results(
        options.out,
        {
            f"{NAME}.md": table,
            f"{NAME}.svg": draw(points, title),
            f"{NAME}.safetensors": lambda path: save_compressed(path, models[chosen.fraction], chosen.precision),
        },
    )
    print(table)
    print(written)
    return 0


if __name__ == "__main__":
    sys.exit(main())
