"""Data model of a table: columns, rows of cells, caption, footnotes. table_files.py writes it."""

from __future__ import annotations

from dataclasses import dataclass

from pipeline.presentation.statistics import Estimate

EMPTY_NOTE = "Empty cell: no run."
NOT_REPORTED_NOTE = "–: not reported."
SEEDS_NOTE = "±: half the 95 % t-interval of the mean over the seeds; no ±: one seed."


@dataclass(frozen=True)
class Column:
    """A column. `key` heads the CSV (half the interval goes to `key_ci95`), `header` the other formats.

    CSV and LaTeX have all columns. `fold`, `group` and `ours_only` control table_layout.py.
    """

    key: str
    header: str
    number: bool = True
    fold: bool = False  # moved to the caption where all rows have the same text
    group: str = ""  # a wide table is split between groups; "": repeated in each part
    ours_only: bool = False  # hidden where no row of ours has a number


@dataclass(frozen=True)
class Cell:
    """The displayed text and, for a number, its value at full precision for the CSV."""

    text: str = ""
    value: float | None = None
    error: float | None = None  # what follows ±


NO_RUN = Cell("")
NOT_REPORTED = Cell("–")  # the paper gives no number
NOT_MEASURED = Cell("not measured")  # the run lacks the number
NOTHING = Cell("·")  # not applicable, such as a comparison of the baseline with itself


@dataclass(frozen=True)
class Row:
    """Cells by column key; a missing key is an empty cell (no run)."""

    cells: dict[str, Cell]
    kind: str = "ours"  # ours | paper (this paper's numbers) | other (methods that the paper cites)
    mark: str = ""  # footnote marks, printed after the first cell


@dataclass(frozen=True)
class Table:
    """A table. `slug` names its files; `notes` are footnotes, each (mark or "", text)."""

    slug: str
    title: str
    columns: tuple[Column, ...]
    rows: tuple[Row, ...]
    caption: str = ""
    notes: tuple[tuple[str, str], ...] = ()
    over_seeds: bool = True  # whether our numbers are means over seeds
    section: str = "comparisons"  # of the report

    def cell(self, row: Row, column: Column) -> Cell:
        return row.cells.get(column.key, NO_RUN)

    @property
    def footnotes(self) -> tuple[tuple[str, str], ...]:
        """`notes` and the legend of –, n/a, ± and empty cells, where they occur."""
        cells = [self.cell(row, column) for row in self.rows for column in self.columns]
        ours = [cell for row in self.rows if row.kind == "ours" for cell in row.cells.values()]
        legend = (
            (EMPTY_NOTE, NO_RUN in cells),
            (NOT_REPORTED_NOTE, NOT_REPORTED in cells),
            (SEEDS_NOTE, self.over_seeds and any(cell.value is not None for cell in ours)),
        )
        return self.notes + tuple(("", text) for text, occurs in legend if occurs)


def number(value: float, decimals: int = 2) -> Cell:
    """One of our numbers; NaN: not measured."""
    return NOT_MEASURED if value != value else Cell(f"{value:,.{decimals}f}", float(value))


def measured(estimate: Estimate | None, decimals: int = 2) -> Cell:
    """mean ± half its t-interval; None: not measured."""
    if estimate is None:
        return NOT_MEASURED
    return _with_interval(estimate, f"{estimate.mean:,.{decimals}f}", decimals)


def signed(found: Estimate, decimals: int = 2) -> Cell:
    """difference ± half its t-interval."""
    return _with_interval(found, f"{found.mean:+,.{decimals}f}", decimals)


def _with_interval(found: Estimate, mean: str, decimals: int) -> Cell:
    """Without ± for one seed."""
    half = found.half_width
    return Cell(mean, found.mean) if half != half else Cell(f"{mean} ± {half:,.{decimals}f}", found.mean, half)


def printed(value: str) -> Cell:
    """A number exactly as printed in the paper, or a range of them; an empty string: not reported."""
    try:
        return Cell(value, float(value))
    except ValueError:
        return Cell(value) if value else NOT_REPORTED
