"""Writes a table as Markdown (padded to read in a terminal), CSV (one number per cell) and LaTeX."""

from __future__ import annotations

from pipeline.presentation.table import NOT_MEASURED, NOT_REPORTED, NOTHING, Cell, Column, Row, Table
from pipeline.presentation.table_layout import laid_out
from pipeline.runs.run_folder import csv_text

# fmt: off
_LATEX = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_", "{": r"\{", "}": r"\}",
    "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "<": r"\textless{}", ">": r"\textgreater{}",
    "±": r"$\pm$", "×": r"$\times$", "−": r"$-$", "–": r"--", "·": r"$\cdot$", "…": r"\ldots{}",
    "↑": r"$\uparrow$", "↓": r"$\downarrow$", "√": r"$\surd$", "≥": r"$\geq$",
    "¹": r"$^{1}$", "²": r"$^{2}$", "³": r"$^{3}$", "⁴": r"$^{4}$", "⁵": r"$^{5}$", "⁶": r"$^{6}$",
    "⁷": r"$^{7}$", "⁸": r"$^{8}$", "₁": r"$_{1}$", "₂": r"$_{2}$",
}
# fmt: on


def files_of(table: Table, with_latex: bool = False) -> dict[str, bytes]:
    """<slug>.md and .csv, with `with_latex` also .tex -> content."""
    written = {"md": markdown(table), "csv": comma_separated(table)}
    if with_latex:
        written["tex"] = latex(table)
    return {f"{table.slug}.{suffix}": content.encode("utf-8") for suffix, content in written.items()}


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
    head = [name for c in table.columns for name in ([c.key, f"{c.key}_ci95"] if c.key in with_error else [c.key])]
    lines = []
    for row in table.rows:
        line: list[str] = [row.kind]
        for column in table.columns:
            cell = table.cell(row, column)
            line.append(_csv_cell(cell, row))
            if column.key in with_error:
                line.append(_plain(cell.error) if cell.error is not None else "")
        lines.append([*line, row.mark])
    return csv_text(["kind", *head, "note"], lines)


def _csv_cell(cell: Cell, row: Row) -> str:
    if cell == NOT_MEASURED:
        return "n/a"  # which pandas and R read as a missing number
    if cell in (NOT_REPORTED, NOTHING):
        return ""
    as_printed = row.kind != "ours" and cell.error is None  # the paper's numbers keep their digits
    return cell.text if cell.value is None or as_printed else _plain(cell.value)


def latex(table: Table) -> str:
    r"""A table environment with booktabs rules; a \midrule separates the paper's rows from ours."""
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
    return "".join(_LATEX.get(character, character) for character in text)


def _shown(table: Table, row: Row, column: Column) -> str:
    """The cell's text, with the row's footnote mark after the first column."""
    mark = row.mark if column is table.columns[0] else ""
    return table.cell(row, column).text + mark


def _plain(value: float) -> str:
    return str(int(value)) if value == int(value) and abs(value) < 1e15 else repr(value)
