"""`python -m pipeline.studies.kernel_stability [--steps 100] [--only FAMILY …]`: the table; exit status 1 where a bound is broken."""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import torch
from rich.console import Console
from rich.progress import track

from pipeline.runs.provenance import git_commit, machine_line
from pipeline.runs.run_folder import now
from pipeline.studies.kernel_stability import textbook
from pipeline.studies.kernel_stability.cases import CASES, Case
from pipeline.studies.kernel_stability.families import FAMILIES
from pipeline.studies.kernel_stability.instruction_sets import measure_spread
from pipeline.studies.kernel_stability.measure import kernel_indefinite, measure
from pipeline.studies.kernel_stability.table import Row, show, write
from pipeline.terminal.closed_pipe import quiet_on_closed_pipe
from rasterizer import rasterize
from rasterizer.kernel import available_isas
from rasterizer.reference import render as reference


def measure_case(case: Case, steps: int) -> Row:
    """The kernel with every output, on every instruction set too; the twin in float32 and the textbook's formulas with
    colour, alpha and depth."""
    gaussians, request = case.scene()
    steps = min(steps, case.most_steps)
    basic = replace(request, outputs=textbook.OUTPUTS)
    none = lambda *_: 0  # noqa: E731  # A Aᵀ is positive semi-definite by construction
    return Row(
        case,
        {
            "kernel": measure(partial(rasterize, threads=1), kernel_indefinite, gaussians, request, steps),
            "twin": measure(reference.rasterize, none, gaussians, basic, steps),
            "textbook": measure(textbook.rasterize, textbook.indefinite, gaussians, basic, steps),
        },
        measure_spread(gaussians, request),
    )


@quiet_on_closed_pipe()
def main(arguments: list[str] | None = None) -> int:
    """The command; returns the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m pipeline.studies.kernel_stability",
        description="Hard cases: the float32 kernel, "
        "the twin and the textbook's formulas in float32, against the twin in float64.",
    )
    parser.add_argument("--steps", type=int, default=100, help="optimiser steps a case (default: %(default)s)")
    parser.add_argument("--only", nargs="+", choices=list(FAMILIES), metavar="FAMILY", help="these families alone")
    parser.add_argument("--out", type=Path, default=Path("results/stability"), help="folder (default: %(default)s)")
    options = parser.parse_args(arguments)
    torch.set_num_threads(1)
    cases = [case for case in CASES if not options.only or case.family in options.only]
    console = Console()
    rows = [measure_case(case, options.steps) for case in track(cases, console=console, transient=True)]
    show(rows, console)
    write(
        rows,
        options.out,
        f"`python -m pipeline.studies.kernel_stability --steps {options.steps}` on {machine_line()}, {now()}, "
        f"commit {git_commit()}. Instruction sets: {', '.join(available_isas())}.",
    )
    broken = [row for row in rows if row.broken]
    for row in broken:
        print(f"{row.case.name}: {'; '.join(row.broken)}", file=sys.stderr)
    print(f"{len(rows) - len(broken)} of {len(rows)} cases hold; written to {options.out}")
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
