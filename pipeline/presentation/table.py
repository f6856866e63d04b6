"""What a table is: columns, rows of cells, footnotes. How it is written is export.py's business."""

from __future__ import annotations

from dataclasses import dataclass

from pipeline.presentation.seeds import Estimate

EMPTY_NOTE = "Empty cell: no run."
NOT_REPORTED_NOTE = "–: not reported."
NOT_MEASURED_NOTE = "n/a: not measured in these runs."
SEEDS_NOTE = "±: standard deviation over seeds (n − 1); no ±: one seed."


@dataclass(frozen=True)
class Column:
    """`key` heads the CSV (its std goes to `key_std`), `header` the rest; numbers are right-aligned.

    CSV and LaTeX have all columns. How layout.py makes the table fit a page, the others say.
    """

    key: str
    header: str
    number: bool = True
    fold: bool = False  # goes into the caption where all rows say the same
    group: str = ""  # columns of a group stay together when the table is split; "": repeated in each part
    ours_only: bool = False  # shown only where one of our rows has a number


@dataclass(frozen=True)
class Cell:
    """What is read (`text`) and, for a number, its value at full precision for the CSV."""

    text: str = ""
    value: float | None = None
    std: float | None = None


NO_RUN = Cell("")
NOT_REPORTED = Cell("–")  # the paper gives no number
NOT_MEASURED = Cell("n/a")  # there is a run, the number was not measured
NOTHING = Cell("·")  # there is nothing to compare


@dataclass(frozen=True)
class Row:
    """Cells by column key; a column without one is an empty cell (no run)."""

    cells: dict[str, Cell]
    kind: str = "ours"  # ours | paper (this paper's numbers) | other (what the paper cites): for styling
    mark: str = ""  # footnote marks, printed after the first cell


@dataclass(frozen=True)
class Table:
    """`slug` names its files; `notes` are footnotes, each (mark or "", text)."""

    slug: str
    title: str
    columns: tuple[Column, ...]
    rows: tuple[Row, ...]
    caption: str = ""
    notes: tuple[tuple[str, str], ...] = ()
    over_seeds: bool = True  # our numbers are means over seeds

    def cell(self, row: Row, column: Column) -> Cell:
        """The cell of `row` under `column`."""
        return row.cells.get(column.key, NO_RUN)

    @property
    def footnotes(self) -> tuple[tuple[str, str], ...]:
        """`notes` and what the marks –, n/a, ± and an empty cell mean, as far as they occur."""
        cells = [self.cell(row, column) for row in self.rows for column in self.columns]
        legend = [
            (EMPTY_NOTE, any(c == NO_RUN for c in cells)),
            (NOT_REPORTED_NOTE, any(c == NOT_REPORTED for c in cells)),
            (NOT_MEASURED_NOTE, any(c == NOT_MEASURED for c in cells)),
            (
                SEEDS_NOTE,
                self.over_seeds
                and any(row.kind == "ours" and c.value is not None for row in self.rows for c in row.cells.values()),
            ),
        ]
        return self.notes + tuple(("", text) for text, occurs in legend if occurs)


def text(value: str) -> Cell:
    """A cell of words."""
    return Cell(value)


def number(value: float, decimals: int = 2) -> Cell:
    """A number of ours; NaN is one that was not measured."""
    return NOT_MEASURED if value != value else Cell(f"{value:,.{decimals}f}", float(value))


def uncertainty(value: float) -> Cell:
    """An error of a difference of ours; NaN: one seed has none."""
    return NOTHING if value != value else number(value)


def measured(estimate: Estimate | None, decimals: int = 2) -> Cell:
    """mean ± std over seeds; None is a number that a run lacks."""
    if estimate is None:
        return NOT_MEASURED
    if estimate.std != estimate.std:
        return Cell(f"{estimate.mean:,.{decimals}f}", estimate.mean)
    return Cell(f"{estimate.mean:,.{decimals}f} ± {estimate.std:,.{decimals}f}", estimate.mean, estimate.std)


def printed(value: str) -> Cell:
    """A number exactly as the paper prints it; an empty string is one it does not give."""
    return Cell(value, float(value)) if value else NOT_REPORTED
