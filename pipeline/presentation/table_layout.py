"""Fits a table to a page: drops empty columns, moves constant columns to the caption, splits wide tables.

Columns that were never measured are named in a note. A wide table is split between column groups (quality, cost, ...);
columns without a group are repeated in each part. The CSV keeps all columns.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

from pipeline.presentation.table import NO_RUN, NOT_MEASURED, NOT_REPORTED, NOTHING, Column, Table

WIDTH = 140  # characters, with the space between columns: what fits on a page 1200 pixels wide
_BETWEEN = 3
_MAX_TEXT = 28  # longer texts are wrapped
_EMPTY = (NO_RUN, NOT_MEASURED, NOT_REPORTED, NOTHING)


@dataclass(frozen=True)
class Layout:
    """`table` with the displayed rows and columns; `parts`: the columns of each part."""

    table: Table
    parts: tuple[tuple[Column, ...], ...]


def laid_out(table: Table, width: int = WIDTH) -> Layout:
    """The layout for parts of at most `width` characters; a part with a single column group may be wider."""
    shown = folded(without_empty(table))
    return Layout(shown, _parts(shown, width))


def without_empty(table: Table) -> Table:
    """The table without columns that have no number in any row; a note names those that were not measured.

    A column with `ours_only` needs a number in a row of ours. Rows of the paper that lose all numbers are dropped too.
    """
    empty = [column for column in table.columns[1:] if _is_empty(table, column)]
    columns = tuple(column for column in table.columns if column not in empty)
    missing = [_plain(c.header) for c in empty if any(table.cell(row, c) == NOT_MEASURED for row in table.rows)]
    notes = (("", f"Not measured in these runs: {', '.join(missing)}."),) if missing else ()
    rows = table.rows
    if any(column.ours_only for column in empty):
        rows = tuple(
            row
            for row in rows
            if row.kind == "ours" or any(table.cell(row, column).value is not None for column in columns)
        )
    marks = "".join(row.mark for row in rows)
    kept = tuple((mark, note) for mark, note in table.notes if not mark or mark in marks)
    return replace(table, columns=columns, rows=rows, notes=kept + notes)


def folded(table: Table) -> Table:
    """The table with those `fold` columns moved to the caption that have the same text in all rows."""
    texts = {column: {table.cell(row, column).text for row in table.rows} for column in table.columns if column.fold}
    constant = {column: found.pop() for column, found in texts.items() if len(found) == 1}
    if not constant:
        return table
    sentence = "; ".join(f"{_plain(column.header)}: {text}" for column, text in constant.items()) + "."
    columns = tuple(column for column in table.columns if column not in constant)
    return replace(table, columns=columns, caption=f"{sentence} {table.caption}".strip())


def _is_empty(table: Table, column: Column) -> bool:
    rows = [row for row in table.rows if row.kind == "ours"] if column.ours_only else table.rows
    return all(table.cell(row, column) in _EMPTY for row in rows)


def _parts(table: Table, width: int) -> tuple[tuple[Column, ...], ...]:
    """All columns where they fit, else as many groups per part as fit; too wide a group is split by column."""
    if sum(_width(table, column) for column in table.columns) <= width:
        return (table.columns,)
    repeated = tuple(column for column in table.columns if not column.group)
    groups: dict[str, list[Column]] = {}
    for column in table.columns:
        if column.group:
            groups.setdefault(column.group, []).append(column)
    left = width - sum(_width(table, column) for column in repeated)
    parts: list[list[Column]] = []
    for group in groups.values():
        total = sum(_width(table, column) for column in group)
        for piece in [group] if total <= left else [[column] for column in group]:
            wide = sum(_width(table, column) for column in piece)
            if parts and wide + sum(_width(table, column) for column in parts[-1]) <= left:
                parts[-1] += piece
            else:
                parts.append(list(piece))
    return tuple((*repeated, *part) for part in parts) or (table.columns,)


def _width(table: Table, column: Column) -> int:
    """Characters of the column. Headers and texts wrap between words; numbers do not."""
    cells = max((len(table.cell(row, column).text) for row in table.rows), default=0)
    header = max(len(word) for word in column.header.split())
    return max(header, cells if column.number else min(cells, _MAX_TEXT)) + _BETWEEN


def _plain(header: str) -> str:
    return re.sub(r" [↑↓]", "", header)
