"""Numerical stability of the kernel: float32 errors in ill-conditioned scenes, each with a bound.

Compares the float32 kernel, the reference implementation in float32, and the textbook formulas in float32 with the
reference implementation in float64; and the kernel's instruction sets with each other. Writes kernel_stability.md, a
line a family, and kernel_stability.csv, a line a case and program. Exit status 1 where the kernel exceeds a bound.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial

import torch
from rich.console import Console
from rich.progress import track

from pipeline.runs.run_folder import csv_text
from pipeline.studies.common import StudyParser, made_by, markdown_table, write_results
from pipeline.studies.kernel_stability import textbook_formulas
from pipeline.studies.kernel_stability.cases import CASES, Case
from pipeline.studies.kernel_stability.instruction_sets import Spread, measure_spread
from pipeline.studies.kernel_stability.measure import Errors, kernel_indefinite, measure
from pipeline.studies.kernel_stability.scenes import FAMILIES
from pipeline.terminal.command_line import command
from rasterizer import rasterize
from rasterizer.kernel_loader import available_isas
from rasterizer.reference import render as reference

NAME = "kernel_stability"
PROGRAMS = ("kernel", "reference", "textbook")  # all in float32; the last is the reference with textbook formulas
HEADER = ("family", "parameter", "kernel", "steps", "reference", "textbook", "instruction sets", "beyond a bound")
LEGEND = (
    "Largest errors of a family's cases against the float64 reference implementation: image, gradient (the largest of "
    "their tensor is 1); steps: loss after the optimiser steps. Instruction sets: the kernel's largest difference "
    "between them. inf: a value that is NaN or infinite. Last column: cases in which the kernel exceeds a bound."
)


@dataclass(frozen=True)
class Row:
    """A case with its errors against the float64 reference, by program, and between the kernel's instruction sets."""

    case: Case
    errors: dict[str, Errors]
    spread: Spread | None = None  # None: not measured

    @property
    def violations(self) -> list[str]:
        """The bounds that the kernel exceeds, in words. Those between instruction sets are the same as to the truth."""
        found, case = self.errors["kernel"], self.case
        checks = [
            ("image", found.image, case.image_bound),
            ("gradient", found.gradient, case.gradient_bound),
            ("steps", found.steps, case.steps_bound),
            ("non-finite values", found.non_finite, 0),
            ("indefinite covariances", found.indefinite, 0),
        ]
        if self.spread is not None:
            checks += [
                ("image between instruction sets", self.spread.image, case.image_bound),
                ("gradient between instruction sets", self.spread.gradient, case.gradient_bound),
                ("instruction sets with other bits on 2 threads", len(self.spread.changed_by_threads), 0),
            ]
        return [
            f"{name} {value:.1e} > {bound:g}"
            for name, value, bound in checks
            if not (value <= bound and math.isfinite(value))
        ]


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


def markdown(rows: Sequence[Row], heading: str) -> str:
    lines = []
    for name in dict.fromkeys(row.case.family for row in rows):
        group = [row for row in rows if row.case.family == name]
        errors = {program: [row.errors[program] for row in group] for program in PROGRAMS}
        images = {program: f"{max(e.image for e in found):.1e}" for program, found in errors.items()}
        both = {program: f"{images[program]}, {max(e.gradient for e in errors[program]):.1e}" for program in PROGRAMS}
        steps = max((r.errors["kernel"].steps for r in group if math.isfinite(r.case.steps_bound)), default=0.0)
        spreads = [row.spread for row in group if row.spread is not None]
        spread = f"{max(s.image for s in spreads):.1e}, {max(s.gradient for s in spreads):.1e}" if spreads else ""
        exceeded = "; ".join(row.case.name for row in group if row.violations) or "none"
        parameter = FAMILIES[name].parameter
        lines.append(
            [name, parameter, both["kernel"], f"{steps:.1e}", both["reference"], both["textbook"], spread, exceeded]
        )
    reasons = [f"- {row.case.name}: {row.case.why}" for row in rows if row.case.why]
    reasons = ["", "Cases with other bounds, and why:", "", *reasons] if reasons else []
    table = markdown_table(HEADER, lines)
    return "\n".join(["# Numerical stability of the kernel", "", heading, "", LEGEND, "", table, *reasons]) + "\n"


def comma_separated(rows: Sequence[Row]) -> str:
    """One line for each case and program; the last columns, between instruction sets, are of the kernel."""
    case_columns = ("family", "value", "seed", "image_bound", "gradient_bound", "steps_bound")
    header = [
        *case_columns,
        "program",
        *Errors.__dataclass_fields__,
        "isas_image",
        "isas_gradient",
        "changed_by_threads",
    ]
    lines = []
    for row in rows:
        for program, errors in row.errors.items():
            spread = row.spread if program == "kernel" else None
            last = (
                ["", "", ""] if spread is None else [spread.image, spread.gradient, " ".join(spread.changed_by_threads)]
            )
            lines.append(
                [*(getattr(row.case, name) for name in case_columns), program, *asdict(errors).values(), *last]
            )
    return csv_text(header, lines)


@command
def main(arguments: list[str]) -> int:
    parser = StudyParser(NAME, __doc__)
    steps, only = "optimiser steps for each case (default: %(default)s)", f"default: all of {', '.join(FAMILIES)}"
    parser.add_argument("--steps", type=int, default=100, metavar="N", help=steps)
    parser.add_argument("--only", nargs="+", choices=list(FAMILIES), metavar="FAMILY", help=only)
    options = parser.parse_args(arguments)
    parser.require(options.steps >= 0, "--steps", "at least 0", options.steps)
    torch.set_num_threads(1)
    cases = [case for case in CASES if not options.only or case.family in options.only]
    rows = [measure_case(case, options.steps) for case in track(cases, console=Console(), transient=True)]
    heading = f"{made_by(NAME, arguments)}. Instruction sets: {', '.join(available_isas())}."
    table = markdown(rows, heading)
    write_results(options.out, NAME, table, {"csv": comma_separated(rows)})
    exceeded = [row for row in rows if row.violations]
    for row in exceeded:
        print(f"{row.case.name}: {'; '.join(row.violations)}", file=sys.stderr)
    print(f"{len(rows) - len(exceeded)} of {len(rows)} cases are within their bounds")
    return 1 if exceeded else 0


if __name__ == "__main__":
    sys.exit(main())
