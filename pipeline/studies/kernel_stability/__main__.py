"""Numerical stability of the kernel: float32 errors in ill-conditioned scenes, each with a bound.

Compares the float32 kernel, the reference implementation in float32, and the textbook formulas in float32 with the
reference implementation in float64; and the kernel's instruction sets with each other. Further checks: Gaussians on the
cut-off in time, an image of 8192 × 8192, coefficients in 16 bits, a long training. Writes kernel_stability.md, a line a
family, and kernel_stability.csv, a line a case and program. Exit status 1 where the kernel exceeds a bound.
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
from pipeline.studies.kernel_stability.cases import CASES, SLOW, Case
from pipeline.studies.kernel_stability.checks import Check
from pipeline.studies.kernel_stability.half_precision import half_precision_checks
from pipeline.studies.kernel_stability.instruction_sets import Spread, measure_spread
from pipeline.studies.kernel_stability.large_image import large_image_check
from pipeline.studies.kernel_stability.long_training import STEPS, long_training_check
from pipeline.studies.kernel_stability.measure import Errors, kernel_indefinite, measure, shown
from pipeline.studies.kernel_stability.on_the_cut_off import cut_off_checks
from pipeline.studies.kernel_stability.scenes import FAMILIES
from pipeline.terminal.command_line import command
from rasterizer import rasterize
from rasterizer.kernel_loader import available_isas
from rasterizer.reference import render as reference
from rasterizer.reference.discontinuities import away_from_discontinuities

NAME = "kernel_stability"
PROGRAMS = ("kernel", "reference", "textbook")  # all in float32; the last is the reference with textbook formulas
HEADER = ("family", "parameter", "cases", "kernel", "steps", "reference", "textbook", "instruction sets", "beyond")
LEGEND = (
    "Cases: those that show a Gaussian away from a discontinuity, of all; the others compare nothing, only that values "
    "are finite. Largest errors of the former against the float64 reference implementation: image, gradient (the "
    "largest of their tensor is 1); steps: loss after the optimiser steps. Instruction sets: the kernel's largest "
    "difference between them. inf: a value that is NaN or infinite. n/a: nothing is compared. Last column: cases in "
    "which the kernel exceeds a bound."
)
CHECKS_HEADER = ("check", "compared", "image", "gradient", "bounds")
NOTHING = "n/a"


@dataclass(frozen=True)
class Row:
    """A case with its errors against the float64 reference, by program, and between the kernel's instruction sets."""

    case: Case
    errors: dict[str, Errors]
    spread: Spread | None = None  # None: not measured
    compared: int = 1  # Gaussians shown away from discontinuities; 0: the case compares nothing

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
        shown(away_from_discontinuities(gaussians, request), request),
    )


def markdown(rows: Sequence[Row], heading: str, checks: Sequence[Check] = (), training: str = "") -> str:
    lines = []
    for name in dict.fromkeys(row.case.family for row in rows):
        everything = [row for row in rows if row.case.family == name]
        group = [row for row in everything if row.compared]
        exceeded = "; ".join(row.case.name for row in everything if row.violations) or "none"
        parameter, number = FAMILIES[name].parameter, f"{len(group)} of {len(everything)}"
        if not group:
            lines.append([name, parameter, number, *[NOTHING] * 5, exceeded])
            continue
        errors = {program: [row.errors[program] for row in group] for program in PROGRAMS}
        images = {program: f"{max(e.image for e in found):.1e}" for program, found in errors.items()}
        both = {program: f"{images[program]}, {max(e.gradient for e in errors[program]):.1e}" for program in PROGRAMS}
        steps = max((r.errors["kernel"].steps for r in group if math.isfinite(r.case.steps_bound)), default=0.0)
        spreads = [row.spread for row in group if row.spread is not None]
        spread = f"{max(s.image for s in spreads):.1e}, {max(s.gradient for s in spreads):.1e}" if spreads else ""
        bounded = any(math.isfinite(r.case.steps_bound) and r.case.most_steps for r in group)
        after = f"{steps:.1e}" if bounded else NOTHING
        lines.append(
            [name, parameter, number, both["kernel"], after, both["reference"], both["textbook"], spread, exceeded]
        )
    reasons = [f"- {row.case.name}: {row.case.why}" for row in rows if row.case.why]
    reasons = ["", "Cases with other bounds, and why:", "", *reasons] if reasons else []
    table = markdown_table(HEADER, lines)
    further = ["", "Further checks:", "", checks_table(checks)] if checks else []
    further += ["", "The long training, by step:", "", training] if training else []
    return (
        "\n".join(["# Numerical stability of the kernel", "", heading, "", LEGEND, "", table, *further, *reasons])
        + "\n"
    )


def checks_table(checks: Sequence[Check]) -> str:
    def shown(error: float) -> str:
        return NOTHING if math.isnan(error) else f"{error:.1e}"

    lines = []
    for check in checks:
        bounds = ", ".join(f"{b:g}" for b in (check.image_bound, check.gradient_bound) if math.isfinite(b))
        bounds += f" ({check.why})" if check.why else ""
        exceeded = " **exceeded**" if check.exceeded else ""
        lines.append([check.name, check.compared, shown(check.image), shown(check.gradient), bounds + exceeded])
    return markdown_table(CHECKS_HEADER, lines)


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
        "compared",
    ]
    lines = []
    for row in rows:
        for program, errors in row.errors.items():
            spread = row.spread if program == "kernel" else None
            last = (
                ["", "", ""] if spread is None else [spread.image, spread.gradient, " ".join(spread.changed_by_threads)]
            )
            lines.append(
                [
                    *(getattr(row.case, name) for name in case_columns),
                    program,
                    *asdict(errors).values(),
                    *last,
                    row.compared,
                ]
            )
    return csv_text(header, lines)


@command
def main(arguments: list[str]) -> int:
    parser = StudyParser(NAME, __doc__)
    steps, only = "optimiser steps for each case (default: %(default)s)", f"default: all of {', '.join(FAMILIES)}"
    parser.add_argument("--steps", type=int, default=100, metavar="N", help=steps)
    long = "steps of the long training; 0: no further checks (default: %(default)s, with --only 0)"
    parser.add_argument("--long-steps", type=int, metavar="N", help=long, default=None)
    parser.add_argument("--only", nargs="+", choices=list(FAMILIES), metavar="FAMILY", help=only)
    options = parser.parse_args(arguments)
    parser.require(options.steps >= 0, "--steps", "at least 0", options.steps)
    torch.set_num_threads(1)
    cases = [case for case in CASES if not options.only or case.family in options.only]
    rows = [measure_case(case, options.steps) for case in track(cases, console=Console(), transient=True)]
    long_steps = options.long_steps if options.long_steps is not None else 0 if options.only else STEPS
    checks, training = further_checks(cases, long_steps) if long_steps else ([], "")
    heading = f"{made_by(NAME, arguments)}. Instruction sets: {', '.join(available_isas())}."
    table = markdown(rows, heading, checks, training)
    write_results(options.out, NAME, table, {"csv": comma_separated(rows)})
    exceeded = [row for row in rows if row.violations]
    for row in exceeded:
        print(f"{row.case.name}: {'; '.join(row.violations)}", file=sys.stderr)
    for check in (broken := [check for check in checks if check.exceeded]):
        print(f"{check.name}: {check.image:.1e}, {check.gradient:.1e}", file=sys.stderr)
    compared = [row for row in rows if row.compared]
    held = len(compared) - sum(row in exceeded for row in compared)
    print(f"{held} of {len(compared)} cases are within their bounds, {len(rows) - len(compared)} compare nothing")
    return 1 if exceeded or broken else 0


def further_checks(cases: Sequence[Case], long_steps: int) -> tuple[list[Check], str]:
    """The checks that are in no family, and the table of the long training."""
    long, training = long_training_check(long_steps)
    quick = [case for case in cases if case.family not in SLOW]
    return [*cut_off_checks(), large_image_check(), *half_precision_checks(quick), long], training


if __name__ == "__main__":
    sys.exit(main())
