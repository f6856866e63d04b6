"""Compression of a trained model: PSNR against file size and speed, pruned and in fewer bits.

Keeps the Gaussians with the largest image sensitivity (each of --fractions), retrains them for the last --retrain of
the run's schedule, stores each model as float32, float16 and int8, and measures it on the run's test views. Writes
compression.md, compression.svg, and the smallest model within --loss dB of the full one (compression.safetensors).
"""

from __future__ import annotations

import math
import sys
from pathlib import Path

import torch

from pipeline.studies.command_line import Provenance, StudyParser, log, study_command
from pipeline.studies.compression.measure import measure, pruned_models, smallest
from pipeline.studies.compression.plot import draw
from pipeline.studies.compression.storage import save_compressed
from pipeline.studies.compression.table import markdown
from pipeline.studies.output import write_results
from pipeline.trained.open_run import open_run

NAME = "compression"
FRACTIONS = (0.8, 0.7, 0.6, 0.5, 0.4)


@study_command
def main(arguments: list[str]) -> int:
    parser = StudyParser(NAME, __doc__)
    parser.add_argument("run", type=Path, metavar="RUN", help="folder of a finished run")
    parser.add_argument(
        "--loss", type=float, default=0.1, metavar="DB", help="allowed loss of PSNR, dB (default: %(default)s)"
    )
    parser.add_argument(
        "--retrain",
        type=float,
        default=0.6,
        metavar="SHARE",
        help="part of the schedule for which pruned models are retrained, 0 to 1 (default: %(default)s)",
    )
    parser.add_argument(
        "--fractions",
        type=float,
        nargs="+",
        default=FRACTIONS,
        metavar="F",
        help=f"fractions of the Gaussians to keep, besides all of them (default: {' '.join(map(str, FRACTIONS))})",
    )
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
    heading = (
        f"{cfg.scene.name}, {cfg.ablation.name}, {cfg.train.name}, seed {cfg.seed}. {Provenance.of(NAME, arguments)}."
    )
    table = markdown(points, chosen, heading, options.retrain)
    written = write_results(
        options.out,
        {
            f"{NAME}.md": table,
            f"{NAME}.svg": draw(points, f"{cfg.scene.name}, {cfg.train.name}"),
            f"{NAME}.safetensors": lambda path: save_compressed(path, models[chosen.fraction], chosen.precision),
        },
    )
    print(table)
    print(written)
    return 0


if __name__ == "__main__":
    sys.exit(main())
