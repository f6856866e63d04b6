"""Tables as Markdown, CSV and LaTeX."""

from __future__ import annotations

from pipeline.presentation.table import Cell, Column, Row, Table
from pipeline.presentation.table_files import comma_separated, escape, latex, markdown


def test_latex_escapes_every_special_character() -> None:
    assert escape(r"a_b & 50% {$#~^\ ± ×") == (
        r"a\_b \& 50\% \{\$\#\textasciitilde{}\textasciicircum{}\textbackslash{} $\pm$ $\times$"
    )
    table = Table(
        "t",
        "no_4drot & more",
        (Column("a", "A_1", False), Column("b", "B")),
        (Row({"a": Cell("x_y"), "b": Cell("1.00 ± 0.10", 1.0, 0.1)}, mark="¹"),),
    )
    source = latex(table)
    assert r"x\_y$^{1}$ & 1.00 $\pm$ 0.10 \\" in source
    assert r"\caption{no\_4drot \& more}" in source
    assert source.count("{") == source.count("}")


def test_csv_names_what_follows_the_sign_of_uncertainty() -> None:
    columns = (Column("a", "A", False), Column("b", "B"), Column("c", "C"))
    row = Row({"a": Cell("x|y"), "b": Cell("1.0 ± 0.5", 1.0, 0.5), "c": Cell("+2.0 ± 0.3", 2.0, 0.3)})
    assert comma_separated(Table("t", "T", columns, (row,))).splitlines() == [
        "kind,a,b,b_ci95,c,c_ci95,note",
        "ours,x|y,1,0.5,2,0.3,",
    ]


def test_markdown_columns_are_aligned() -> None:
    table = Table(
        "t", "T", (Column("a", "A", False), Column("b", "B")), (Row({"a": Cell("x|y"), "b": Cell("1", 1.0)}),)
    )
    lines = [line for line in markdown(table).splitlines() if line.startswith("|")]
    assert len({len(line) for line in lines}) == 1
    assert r"x\|y" in lines[2]
    assert comma_separated(table).splitlines() == ["kind,a,b,note", "ours,x|y,1,"]
