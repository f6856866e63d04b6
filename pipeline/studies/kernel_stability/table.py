"""The cases' rows as a table on the screen, a CSV and a Markdown file."""

from __future__ import annotations

import csv
import math
from dataclasses import asdict, dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Table

from pipeline.studies.kernel_stability.cases import Case
from pipeline.studies.kernel_stability.instruction_sets import Spread
from pipeline.studies.kernel_stability.measure import Errors

PROGRAMS = ("kernel", "twin", "textbook")  # C++ in float32; readable, in float32 too; the textbook's formulas


@dataclass(frozen=True)
class Row:
    """A case and what was measured there: by program, the truth being the twin in float64, and between the kernel's
    instruction sets."""

    case: Case
    errors: dict[str, Errors]
    spread: Spread | None = None  # None: not measured

    @property
    def broken(self) -> list[str]:
        """The bounds that the kernel breaks, in words. Instruction sets may lie as far apart as one from the truth."""
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
                ("instruction sets whose bits threads change", len(self.spread.changed_by_threads), 0),
            ]
        return [
            f"{name} {value:.1e} > {bound:g}"
            for name, value, bound in checks
            if not (value <= bound and math.isfinite(value))
        ]


def number(value: float) -> str:
    return "0" if value == 0 else f"{value:.1e}"


def cells(row: Row) -> list[str]:
    """Case, bound, and for each program image, gradient and steps, then what else is wrong with it."""
    out = [row.case.name, f"{row.case.gradient_bound:g}"]
    for program in PROGRAMS:
        e = row.errors[program]
        wrong = (f" {e.non_finite} NaN" if e.non_finite else "") + (f" {e.indefinite} indef." if e.indefinite else "")
        out.append(f"{number(e.image)} {number(e.gradient)} {number(e.steps)}{wrong}")
    return [*out, *spread_cells(row.spread), "; ".join(row.broken) or "holds"]


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
    "float32 twin",
    "float32 textbook",
    "between instruction sets",
    "2 threads",
    "kernel",
]
LEGEND = (
    "Errors against the float64 twin: image / largest gradient / loss after the optimiser steps. NaN: values "
    "that are not finite; indef.: 2D covariances that are not positive definite. Between instruction sets: the "
    "kernel's largest difference, image / gradient. 2 threads: whether each gives the bits that 1 gives."
)


def show(rows: list[Row], console: Console) -> None:
    table = Table(title=LEGEND, title_justify="left")
    for name in HEADER:
        table.add_column(name, no_wrap=name == "case")
    for row in rows:
        table.add_row(*cells(row), style="bold red" if row.broken else "")
    console.print(table)


def write(rows: list[Row], folder: Path, heading: str) -> None:
    """`stability.csv` and `instruction_sets.csv` with every number, `stability.md` as on the screen under a line that
    says where and when."""
    folder.mkdir(parents=True, exist_ok=True)
    with open(folder / "stability.csv", "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        names = list(asdict(rows[0].errors["kernel"]))
        writer.writerow(["family", "value", "seed", "image_bound", "gradient_bound", "steps_bound", "program", *names])
        for row in rows:
            case = row.case
            for program, errors in row.errors.items():
                writer.writerow(
                    [
                        case.family,
                        case.value,
                        case.seed,
                        case.image_bound,
                        case.gradient_bound,
                        case.steps_bound,
                        program,
                        *asdict(errors).values(),
                    ]
                )
    write_spreads(rows, folder / "instruction_sets.csv")
    lines = [f"# Stability\n\n{heading}\n\n{LEGEND}\n", "| " + " | ".join(HEADER) + " |", "|---" * len(HEADER) + "|"]
    lines += ["| " + " | ".join(cells(row)) + " |" for row in rows]
    reasons = [f"- {row.case.name}: {row.case.why}" for row in rows if row.case.why]
    lines += ["\nWhy some bounds are other than 1e-3:\n", *reasons] if reasons else []
    (folder / "stability.md").write_text("\n".join(lines) + "\n", encoding="utf-8")


def write_spreads(rows: list[Row], path: Path) -> None:
    """A line a case; several names in one cell are separated by spaces."""
    with open(path, "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["family", "value", "seed", *Spread.__dataclass_fields__])
        for row in rows:
            if row.spread is not None:
                values = (" ".join(v) if isinstance(v, tuple) else v for v in asdict(row.spread).values())
                writer.writerow([row.case.family, row.case.value, row.case.seed, *values])
