"""How a table fits a page: without what says nothing, and in parts where it is too wide.

What is the same in every row goes into the caption, what was never measured into a note. The columns of a wide table
are split by their groups (quality, cost …); those without one stand in each part. The CSV stays whole.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

from pipeline.presentation.table import NO_RUN, NOT_MEASURED, NOT_REPORTED, NOTHING, Column, Table

# Characters across: what a page 1200 pixels wide holds in a wide font, with what parts two columns.
WIDTH = 140
_BETWEEN = 3
_LONGEST_WORDS = 28  # longer ones are wrapped
_SAY_NOTHING = (NO_RUN, NOT_MEASURED, NOT_REPORTED, NOTHING)


@dataclass(frozen=True)
class Layout:
    """`table` with the columns and rows that are shown; `parts`: those columns, side by side in each."""

    table: Table
    parts: tuple[tuple[Column, ...], ...]


def laid_out(table: Table, width: int = WIDTH) -> Layout:
    """width: of a part at most, in characters; a part of a repeated and another column may be wider."""
    shown = folded(without_empty(table))
    return Layout(shown, _parts(shown, width))


def without_empty(table: Table) -> Table:
    """Without columns that have no number in any row; what was not measured is said in a note.

    A column that is `ours_only` needs one of ours. Then a row of the paper's may be left without any number: it goes
    too.
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
    """With columns that say the same in all rows in the caption; only those that may (`Column.fold`)."""
    said = {column: {table.cell(row, column).text for row in table.rows} for column in table.columns if column.fold}
    same = {column: texts.pop() for column, texts in said.items() if len(texts) == 1}
    if not same:
        return table
    sentence = "; ".join(f"{_plain(column.header)}: {text}" for column, text in same.items()) + "."
    columns = tuple(column for column in table.columns if column not in same)
    return replace(table, columns=columns, caption=f"{sentence} {table.caption}".strip())


def _is_empty(table: Table, column: Column) -> bool:
    rows = [row for row in table.rows if row.kind == "ours"] if column.ours_only else table.rows
    return all(table.cell(row, column) in _SAY_NOTHING for row in rows)


def _parts(table: Table, width: int) -> tuple[tuple[Column, ...], ...]:
    """All columns where they fit, else by groups, as many of them side by side as fit; a group too wide by column."""
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
        whole = sum(_width(table, column) for column in group)
        for piece in [group] if whole <= left else [[column] for column in group]:
            wide = sum(_width(table, column) for column in piece)
            if parts and wide + sum(_width(table, column) for column in parts[-1]) <= left:
                parts[-1] += piece
            else:
                parts.append(list(piece))
    return tuple((*repeated, *part) for part in parts) or (table.columns,)


def _width(table: Table, column: Column) -> int:
    """Headers are wrapped between words, texts too; numbers are not."""
    cells = max((len(table.cell(row, column).text) for row in table.rows), default=0)
    header = max(len(word) for word in column.header.split())
    return max(header, cells if column.number else min(cells, _LONGEST_WORDS)) + _BETWEEN


def _plain(header: str) -> str:
    return re.sub(r" [↑↓]", "", header)
