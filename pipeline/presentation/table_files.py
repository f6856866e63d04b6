"""Writes a Table as Markdown (padded, so it reads in a terminal), CSV (one number a cell) and LaTeX."""

from __future__ import annotations

import csv
import io

from pipeline.presentation.layout import laid_out
from pipeline.presentation.table import Column, Table

_LATEX = {
    "\\": r"\textbackslash{}",
    "&": r"\&",
    "%": r"\%",
    "$": r"\$",
    "#": r"\#",
    "_": r"\_",
    "{": r"\{",
    "}": r"\}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "±": r"$\pm$",
    "×": r"$\times$",
    "−": r"$-$",
    "–": r"--",
    "·": r"$\cdot$",
    "↑": r"$\uparrow$",
    "↓": r"$\downarrow$",
    "√": r"$\surd$",
    "≥": r"$\geq$",
    "²": r"$^{2}$",
    "¹": r"$^{1}$",
    "³": r"$^{3}$",
    "⁴": r"$^{4}$",
    "⁵": r"$^{5}$",
    "⁶": r"$^{6}$",
    "…": r"\ldots{}",
}


def files_of(table: Table) -> dict[str, bytes]:
    """<slug>.md, .csv and .tex -> content."""
    written = {"md": markdown(table), "csv": comma_separated(table), "tex": latex(table)}
    return {f"{table.slug}.{suffix}": content.encode("utf-8") for suffix, content in written.items()}


def markdown(table: Table) -> str:
    """Title, caption, padded pipe tables (one a part of the layout), footnotes."""
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
    """One number a cell at full precision; std in columns of their own, footnote marks in `note`."""
    with_std = {c.key for c in table.columns if any(table.cell(row, c).std is not None for row in table.rows)}
    head = [name for c in table.columns for name in ([c.key, f"{c.key}_std"] if c.key in with_std else [c.key])]
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(["kind", *head, "note"])
    for row in table.rows:
        line: list[str] = [row.kind]
        for column in table.columns:
            cell = table.cell(row, column)
            if row.kind != "ours" and cell.value is not None and cell.std is None:
                line.append(cell.text)  # as printed in the paper
            else:
                line.append(
                    _plain(cell.value)
                    if cell.value is not None
                    else ""
                    if cell.text in ("–", "n/a", "·")
                    else cell.text
                )
            if column.key in with_std:
                line.append(_plain(cell.std) if cell.std is not None else "")
        writer.writerow([*line, row.mark])
    return buffer.getvalue()


def latex(table: Table) -> str:
    r"""A table environment with booktabs rules; the paper's and our rows are parted by a \midrule."""
    out = [
        "% needs \\usepackage{booktabs}",
        r"\begin{table}",
        r"\centering",
        rf"\caption{{{escape(table.title)}}}",
        rf"\label{{tab:{table.slug}}}",
        r"\begin{tabular}{" + "".join("r" if c.number else "l" for c in table.columns) + "}",
        r"\toprule",
        " & ".join(escape(c.header) for c in table.columns) + r" \\",
        r"\midrule",
    ]
    previous = None
    for row in table.rows:
        ours = row.kind == "ours"
        if previous is not None and ours != previous:
            out.append(r"\midrule")
        previous = ours
        out.append(" & ".join(escape(_shown(table, row, c)) for c in table.columns) + r" \\")
    out += [r"\bottomrule", r"\end{tabular}"]
    notes = ([table.caption] if table.caption else []) + [f"{mark} {note}".strip() for mark, note in table.footnotes]
    out += [r"\par\smallskip\footnotesize " + r" \\ ".join(escape(note) for note in notes)] if notes else []
    return "\n".join([*out, r"\end{table}", ""])


def escape(text: str) -> str:
    """Text that LaTeX prints as it stands."""
    return "".join(_LATEX.get(character, character) for character in text)


def _shown(table: Table, row, column: Column) -> str:
    """The cell's text, with the row's footnote mark after the first column."""
    mark = row.mark if column is table.columns[0] else ""
    return table.cell(row, column).text + mark


def _plain(value: float) -> str:
    return str(int(value)) if value == int(value) and abs(value) < 1e15 else repr(value)
