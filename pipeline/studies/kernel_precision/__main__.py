"""Work and precision of the kernel: error against time for each of its numerical choices.

Builds variants of the kernel, measures their errors against the float64 reference implementation and their CPU time,
and marks the Pareto front and the defaults. Writes kernel_precision.csv, .md and .svg.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import torch

from pipeline.studies.command_line import Provenance, StudyParser, log, study_command
from pipeline.studies.kernel_precision.build import load_variants
from pipeline.studies.kernel_precision.measure import measure
from pipeline.studies.kernel_precision.plot import draw
from pipeline.studies.kernel_precision.table import comma_separated, markdown
from pipeline.studies.kernel_precision.trained_workload import trained_workload
from pipeline.studies.kernel_precision.variants import DEFAULT, all_variants
from pipeline.studies.kernel_precision.verdicts import verdicts
from pipeline.studies.output import write_results
from rasterizer.allocator import keep_freed_memory
from rasterizer.kernel_loader import kernel
from rasterizer.timing.workloads import WORKLOADS, make_workload

NAME = "kernel_precision"


def parse(arguments: list[str]) -> argparse.Namespace:
    parser = StudyParser(NAME, __doc__)
    parser.add_argument(
        "run",
        type=Path,
        nargs="?",
        metavar="RUN",
        help="a trained run, timed in place of --workload: its middle test view",
    )
    parser.add_argument(
        "--workload", choices=WORKLOADS, default="W1", help="scene to time, all of it (default: %(default)s)"
    )
    parser.add_argument(
        "--pixels",
        type=int,
        default=64,
        metavar="N",
        help="errors are measured on the middle N × N pixels (default: %(default)s)",
    )
    parser.add_argument(
        "--rounds", type=int, default=20, metavar="N", help="timings of all kernels in turn (default: %(default)s)"
    )
    parser.add_argument(
        "--only", nargs="+", metavar="VARIANT", help="these variants and the default one (default: all)"
    )
    options = parser.parse_args(arguments)
    known = {variant.name for variant in all_variants()}
    for name in options.only or []:
        parser.require(name in known, "--only", f"some of {', '.join(sorted(known))}", repr(name))
    parser.require(options.pixels >= 1, "--pixels", "at least 1", options.pixels)
    parser.require(options.rounds >= 1, "--rounds", "at least 1", options.rounds)
    return options


@study_command
def main(arguments: list[str]) -> int:
    options = parse(arguments)
    keep_freed_memory()
    torch.set_num_threads(1)
    variants = [v for v in all_variants() if not options.only or v.name in (*options.only, DEFAULT)]
    log(f"building {len({v.name for v in variants if v.is_built})} kernels")
    kernels = load_variants(variants)
    workload = trained_workload(options.run, log) if options.run else make_workload(options.workload)
    pixels = min(options.pixels, workload.camera.width, workload.camera.height)
    points = measure(variants, kernels, workload, workload.cropped(pixels), options.rounds, log)
    scene = str(options.run or options.workload)
    made = Provenance.of(NAME, arguments)
    heading = (
        f"{scene}, {len(workload.gaussians):,} Gaussians, {workload.camera.width}×{workload.camera.height}, "
        f"instruction set {kernel.__name__.rsplit('_', 1)[1]}; errors of its middle {pixels}×{pixels} pixels. {made}."
    )
    table = markdown(points, heading)
    written = write_results(
        options.out,
        {
            f"{NAME}.csv": comma_separated(points),
            f"{NAME}.md": table,
            f"{NAME}.svg": draw(points, f"{scene}, {made.short()}"),
        },
    )
    print(table.split("\n- ")[0])
    print("\n".join(verdicts(points)))
    print(written)
    return 0


if __name__ == "__main__":
    sys.exit(main())
