"""Writes a table as Markdown (padded to read in a terminal) and CSV (one number per cell)."""

from __future__ import annotations

import csv
import io

from pipeline.presentation.table import NOT_MEASURED, NOT_REPORTED, NOTHING, Cell, Column, Row, Table
from pipeline.presentation.table_layout import laid_out


def files_of(table: Table) -> dict[str, bytes]:
    """<slug>.md and .csv -> content."""
    return {f"{table.slug}.md": markdown(table).encode(), f"{table.slug}.csv": comma_separated(table).encode()}


def markdown(table: Table) -> str:
    """Title, caption, one padded pipe table per part of the layout, footnotes."""
    layout = laid_out(table)
    shown = layout.table
    parts = [f"### {shown.title}", ""] + ([shown.caption, ""] if shown.caption else [])
    for columns in layout.parts:
        parts += [*_grid(shown, columns), ""]
    parts += [f"- {mark + ' ' if mark else ''}{note}" for mark, note in shown.footnotes]
    return "\n".join(parts).rstrip() + "\n"


def _grid(table: Table, columns: tuple[Column, ...]) -> list[str]:
    body = [[_shown(table, row, column).replace("|", r"\|") for column in columns] for row in table.rows]
    head = [column.header for column in columns]
    widths = [max(3, *(len(line[i]) for line in [head, *body])) for i in range(len(head))]

    def line(cells: list[str]) -> str:
        padded = (c.rjust(w) if column.number else c.ljust(w) for c, w, column in zip(cells, widths, columns))
        return f"| {' | '.join(padded)} |"

    rule = "|".join("-" * (w + 1) + ":" if column.number else ":" + "-" * (w + 1) for w, column in zip(widths, columns))
    return [line(head), f"|{rule}|", *(line(cells) for cells in body)]


def comma_separated(table: Table) -> str:
    """CSV at full precision, one number per cell: errors in columns of their own, footnote marks in `note`."""
    with_error = {c.key for c in table.columns if any(table.cell(row, c).error is not None for row in table.rows)}
    head = [name for c in table.columns for name in ([c.key, f"{c.key}_{c.error}"] if c.key in with_error else [c.key])]
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(["kind", *head, "note"])
    for row in table.rows:
        line: list[str] = [row.kind]
        for column in table.columns:
            cell = table.cell(row, column)
            line.append(_csv_cell(cell, row))
            if column.key in with_error:
                line.append(_plain(cell.error) if cell.error is not None else "")
        writer.writerow([*line, row.mark])
    return buffer.getvalue()


def _csv_cell(cell: Cell, row: Row) -> str:
    if cell in (NOT_REPORTED, NOT_MEASURED, NOTHING):
        return ""
    as_printed = row.kind != "ours" and cell.error is None  # the paper's numbers keep their digits
    return cell.text if cell.value is None or as_printed else _plain(cell.value)


def _shown(table: Table, row: Row, column: Column) -> str:
    """The cell's text, with the row's footnote mark after the first column."""
    mark = row.mark if column is table.columns[0] else ""
    return table.cell(row, column).text + mark


def _plain(value: float) -> str:
    return str(int(value)) if value == int(value) and abs(value) < 1e15 else repr(value)
