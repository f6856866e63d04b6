"""Numerical stability of the kernel: float32 errors in ill-conditioned scenes, each with a bound.

Compares the float32 kernel, the reference implementation in float32, and the textbook formulas in float32 with the
reference implementation in float64; and the kernel's instruction sets with each other. Writes kernel_stability.md,
kernel_stability.csv and instruction_sets.csv. Exit status 1 where the kernel exceeds a bound.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from functools import partial

import torch
from rich.console import Console
from rich.progress import track

from pipeline.studies.command_line import Provenance, StudyParser, study_command
from pipeline.studies.kernel_stability import textbook_formulas
from pipeline.studies.kernel_stability.cases import CASES, Case
from pipeline.studies.kernel_stability.families import FAMILIES
from pipeline.studies.kernel_stability.instruction_sets import measure_spread
from pipeline.studies.kernel_stability.measure import kernel_indefinite, measure
from pipeline.studies.kernel_stability.table import Row, errors_csv, instruction_sets_csv, markdown, show
from pipeline.studies.output import write_results
from rasterizer import rasterize
from rasterizer.kernel_loader import available_isas
from rasterizer.reference import render as reference

NAME = "kernel_stability"


def measure_case(case: Case, steps: int) -> Row:
    """The kernel with every output, on all instruction sets; the other programs with colour, alpha and depth."""
    gaussians, request = case.scene()
    steps = min(steps, case.most_steps)
    basic = replace(request, outputs=textbook_formulas.OUTPUTS)
    none = lambda *_: 0  # noqa: E731  # A Aᵀ is positive semi-definite by construction
    return Row(
        case,
        {
            "kernel": measure(partial(rasterize, threads=1), kernel_indefinite, gaussians, request, steps),
            "reference": measure(reference.rasterize, none, gaussians, basic, steps),
            "textbook": measure(textbook_formulas.rasterize, textbook_formulas.indefinite, gaussians, basic, steps),
        },
        measure_spread(gaussians, request),
    )


@study_command
def main(arguments: list[str]) -> int:
    parser = StudyParser(NAME, __doc__)
    parser.add_argument(
        "--steps", type=int, default=100, metavar="N", help="optimiser steps for each case (default: %(default)s)"
    )
    parser.add_argument(
        "--only",
        nargs="+",
        choices=list(FAMILIES),
        metavar="FAMILY",
        help=f"these families of cases (default: all): {', '.join(FAMILIES)}",
    )
    options = parser.parse_args(arguments)
    parser.require(options.steps >= 0, "--steps", "at least 0", options.steps)
    torch.set_num_threads(1)
    cases = [case for case in CASES if not options.only or case.family in options.only]
    console = Console()
    rows = [measure_case(case, options.steps) for case in track(cases, console=console, transient=True)]
    heading = f"{Provenance.of(NAME, arguments)}. Instruction sets: {', '.join(available_isas())}."
    written = write_results(
        options.out,
        {
            f"{NAME}.md": markdown(rows, heading),
            f"{NAME}.csv": errors_csv(rows),
            "instruction_sets.csv": instruction_sets_csv(rows),
        },
    )
    show(rows, console)
    exceeded = [row for row in rows if row.violations]
    for row in exceeded:
        print(f"{row.case.name}: {'; '.join(row.violations)}", file=sys.stderr)
    print(f"{len(rows) - len(exceeded)} of {len(rows)} cases hold their bounds")
    print(written)
    return 1 if exceeded else 0


if __name__ == "__main__":
    sys.exit(main())
