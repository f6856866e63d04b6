"""The table of all cases: on the terminal, as Markdown and as CSV."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

from rich.console import Console
from rich.table import Table

from pipeline.studies.kernel_stability.cases import Case
from pipeline.studies.kernel_stability.instruction_sets import Spread
from pipeline.studies.kernel_stability.measure import Errors
from pipeline.studies.output import csv_text

PROGRAMS = ("kernel", "reference", "textbook")  # all in float32; the last is the reference with textbook formulas


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


def number(value: float) -> str:
    return "0" if value == 0 else f"{value:.1e}"


def cells(row: Row) -> list[str]:
    """Case, bound, the errors and counts of each program, instruction sets, threads, verdict on the kernel."""
    out = [row.case.name, f"{row.case.gradient_bound:g}"]
    for program in PROGRAMS:
        e = row.errors[program]
        counts = (f" {e.non_finite} non-finite" if e.non_finite else "") + (
            f" {e.indefinite} indef." if e.indefinite else ""
        )
        out.append(f"{number(e.image)} {number(e.gradient)} {number(e.steps)}{counts}")
    return [*out, *spread_cells(row.spread), "; ".join(row.violations) or "holds"]


def spread_cells(spread: Spread | None) -> tuple[str, str]:
    if spread is None:
        return "", ""
    return (
        f"{number(spread.image)} {number(spread.gradient)}",
        f"other bits: {', '.join(spread.changed_by_threads)}" if spread.changed_by_threads else "same bits",
    )


HEADER = [
    "case",
    "bound",
    "float32 kernel",
    "float32 reference",
    "float32 textbook",
    "between instruction sets",
    "2 threads",
    "kernel",
]
LEGEND = (
    "Errors against the float64 reference implementation: image, largest gradient error, loss after the optimiser "
    "steps. non-finite: number of values that are NaN or infinite; indef.: number of 2D covariances that are not "
    "positive definite. Between instruction sets: the kernel's largest difference, image and gradient. 2 threads: "
    "whether they give the bits of 1 thread."
)


def show(rows: list[Row], console: Console) -> None:
    table = Table(title=LEGEND, title_justify="left")
    for name in HEADER:
        table.add_column(name, no_wrap=name == "case")
    for row in rows:
        table.add_row(*cells(row), style="bold red" if row.violations else "")
    console.print(table)


def markdown(rows: list[Row], heading: str) -> str:
    lines = ["# Numerical stability of the kernel", "", heading, "", LEGEND, ""]
    lines += ["| " + " | ".join(HEADER) + " |", "|---" * len(HEADER) + "|"]
    lines += ["| " + " | ".join(cells(row)) + " |" for row in rows]
    reasons = [f"- {row.case.name}: {row.case.why}" for row in rows if row.case.why]
    lines += ["", "Reasons for bounds other than 1e-3:", "", *reasons] if reasons else []
    return "\n".join(lines) + "\n"


def errors_csv(rows: list[Row]) -> str:
    """One line for each case and program."""
    bounds = ("image_bound", "gradient_bound", "steps_bound")
    header = ["family", "value", "seed", *bounds, "program", *Errors.__dataclass_fields__]
    return csv_text(
        header,
        (
            [
                *(getattr(row.case, name) for name in ("family", "value", "seed", *bounds)),
                program,
                *asdict(errors).values(),
            ]
            for row in rows
            for program, errors in row.errors.items()
        ),
    )


def instruction_sets_csv(rows: list[Row]) -> str:
    """One line for each case; several names in one cell are separated by spaces."""
    lines = []
    for row in rows:
        if row.spread is None:
            continue
        values = (" ".join(v) if isinstance(v, tuple) else v for v in asdict(row.spread).values())
        lines.append([row.case.family, row.case.value, row.case.seed, *values])
    return csv_text(["family", "value", "seed", *Spread.__dataclass_fields__], lines)
