"""Work and precision of the kernel: error against time for each of its numerical choices.

Builds variants of the kernel, measures their errors against the float64 reference implementation and their CPU time,
and marks the Pareto front and the defaults. Writes kernel_precision.csv, .md and .svg.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from pathlib import Path

import torch

from pipeline.studies.common import StudyParser, made_by, write_results
from pipeline.studies.kernel_precision.build import load_variants
from pipeline.studies.kernel_precision.measure import measure
from pipeline.studies.kernel_precision.plot import draw
from pipeline.studies.kernel_precision.table import comma_separated, markdown
from pipeline.studies.kernel_precision.variants import DEFAULT, all_variants
from pipeline.terminal.command_line import command, log
from pipeline.trained.open_run import open_run
from rasterizer import Request
from rasterizer.bench.workloads import WORKLOADS, Workload, make_workload
from rasterizer.cores import keep_freed_memory
from rasterizer.kernel_loader import kernel

NAME = "kernel_precision"


def trained_workload(folder: Path, log: Callable[[str], None]) -> Workload:
    """The final Gaussians of a run from its scene's middle test view, over black and without the environment map.

    ValueError, one line, where `folder` is no trained run or its near plane is not the benchmark's.
    """
    run = open_run(folder, log)
    scene = run.scene
    if not math.isclose(near := run.cfg.scene.near * scene.unit, Request.near):
        raise ValueError(f"{folder}: expected a near plane at {Request.near}, as the benchmark's, found {near}")
    view = scene.test[len(scene.test) // 2]
    return Workload(run.model.gaussians(), view.camera, view.time, scene.duration)


def _parser() -> StudyParser:
    parser = StudyParser(NAME, __doc__)
    add = parser.add_argument
    run = "a trained run, timed in place of --workload: its middle test view"
    add("run", type=Path, nargs="?", metavar="RUN", help=run)
    add("--workload", choices=WORKLOADS, default="W1", help="scene to time, all of it (default: %(default)s)")
    errors = "errors are measured on the middle N × N pixels (default: %(default)s)"
    add("--pixels", type=int, default=64, metavar="N", help=errors)
    rounds = "timings of all kernels in turn (default: %(default)s)"
    add("--rounds", type=int, default=20, metavar="N", help=rounds)
    add("--only", nargs="+", metavar="VARIANT", help="these variants and the default one (default: all)")
    return parser


@command
def main(arguments: list[str]) -> int:
    parser = _parser()
    options = parser.parse_args(arguments)
    known = {variant.name for variant in all_variants()}
    for name in options.only or []:
        parser.require(name in known, "--only", f"some of {', '.join(sorted(known))}", repr(name))
    parser.require(options.pixels >= 1, "--pixels", "at least 1", options.pixels)
    parser.require(options.rounds >= 1, "--rounds", "at least 1", options.rounds)
    keep_freed_memory()
    torch.set_num_threads(1)
    variants = [v for v in all_variants() if not options.only or v.name in (*options.only, DEFAULT)]
    log(f"building {len({v.name for v in variants if v.is_built})} kernels")
    kernels = load_variants(variants)
    workload = trained_workload(options.run, log) if options.run else make_workload(options.workload)
    camera = workload.camera
    pixels = min(options.pixels, camera.width, camera.height)
    points = measure(variants, kernels, workload, workload.cropped(pixels), options.rounds, log)
    heading = (
        f"{options.run or options.workload}, {len(workload.gaussians):,} Gaussians, {camera.width}×{camera.height}, "
        f"instruction set {kernel.__name__.rsplit('_', 1)[1]}; errors of its middle {pixels}×{pixels} pixels"
    )
    table = markdown(points, f"{heading}. {made_by(NAME, arguments)}.")
    write_results(options.out, NAME, table, {"csv": comma_separated(points), "svg": draw(points, heading)})
    return 0


if __name__ == "__main__":
    sys.exit(main())
