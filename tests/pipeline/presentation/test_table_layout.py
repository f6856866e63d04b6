"""Layout of tables: constant and empty columns, splitting of wide tables; the CSV keeps all columns."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from pipeline.presentation.table import NO_RUN, NOT_MEASURED, NOT_REPORTED, NOTHING, Cell, Column, Row, Table, number
from pipeline.presentation.table_files import comma_separated, markdown
from pipeline.presentation.table_layout import laid_out

NAME = Column("name", "Name", False)


def table(columns: list[Column], *rows: dict, kinds: str = "") -> Table:
    """kinds: one letter per row, `p` for a row of the paper."""
    return Table(
        "t",
        "T",
        (NAME, *columns),
        tuple(
            Row({"name": Cell(f"row {i}")} | row, "paper" if kinds[i : i + 1] == "p" else "ours")
            for i, row in enumerate(rows)
        ),
    )


def test_constant_column_moves_to_the_caption() -> None:
    seeds, psnr = Column("seeds", "Seeds", fold=True), Column("psnr", "PSNR ↑")
    same = table([seeds, psnr], {"seeds": number(3, 0), "psnr": number(1)}, {"seeds": number(3, 0), "psnr": number(1)})
    found = laid_out(same)
    assert [c.key for c in found.table.columns] == ["name", "psnr"]  # psnr is constant too, but fold is not set
    assert found.table.caption == "Seeds: 3."
    other = table([seeds], {"seeds": number(3, 0)}, {"seeds": number(2, 0)})
    assert laid_out(other).table == other
    assert "Seeds: 3." in markdown(same) and comma_separated(same).splitlines()[1] == "ours,row 0,3,1,"


def test_column_without_numbers_is_dropped_and_named_in_a_note() -> None:
    columns = [Column("a", "A ↓"), Column("b", "B"), Column("c", "C"), Column("d", "D")]
    shown = laid_out(
        table(
            columns,
            {"a": NOT_MEASURED, "b": NOTHING, "c": NO_RUN, "d": number(1)},
            {"a": NOT_MEASURED, "b": NOTHING, "c": NOT_REPORTED, "d": NOT_MEASURED},
        )
    ).table
    assert [c.key for c in shown.columns] == ["name", "d"]
    assert ("", "Not measured in these runs: A.") in shown.notes and len(shown.notes) == 1


def test_ours_only_column_needs_a_number_of_ours() -> None:
    columns = [Column("a", "A", ours_only=True), Column("b", "B", ours_only=True)]
    rows = {"a": number(1)}, {"b": number(2)}, {"b": number(3)}
    shown = laid_out(table(columns, *rows, kinds="ppo")).table
    assert [c.key for c in shown.columns] == ["name", "b"]
    assert [row.cells["name"].text for row in shown.rows] == ["row 1", "row 2"]


def test_wide_table_is_split_between_groups() -> None:
    columns = [Column(f"{group}{i}", f"{group}{i}", group=group) for group in "xyz" for i in range(3)]
    wide = table(columns, {column.key: number(12345.678, 3) for column in columns})  # 10 characters each, 3 between
    assert len(laid_out(wide, 1000).parts) == 1
    keys = [[column.key for column in part] for part in laid_out(wide, 6 + 3 + 6 * 13).parts]
    assert keys == [["name", "x0", "x1", "x2", "y0", "y1", "y2"], ["name", "z0", "z1", "z2"]]
    keys = [[column.key for column in part] for part in laid_out(wide, 6 + 3 + 2 * 13).parts]  # no group fits
    assert keys[:2] == [["name", "x0", "x1"], ["name", "x2", "y0"]]


@given(
    st.lists(st.tuples(st.integers(1, 40), st.sampled_from(["", "x", "y", "z"]), st.booleans()), max_size=12),
    st.integers(20, 200),
)
def test_every_column_is_shown_and_no_part_is_too_wide(shape: list[tuple[int, str, bool]], width: int) -> None:
    """Except for parts with a single column beside the repeated ones, which cannot be narrower."""
    columns = [Column(f"c{i}", "H", is_number, group=group) for i, (_, group, is_number) in enumerate(shape)]
    cells = {f"c{i}": Cell("w" * length) for i, (length, _, _) in enumerate(shape)}
    found = laid_out(table(columns, cells), width)
    assert {c.key for part in found.parts for c in part} == {"name", *(c.key for c in columns)}
    for part in found.parts:
        split = [column for column in part if column.group]
        assert len(part) == len({column.key for column in part}) and part[0].key == "name"
        across = (
            sum(
                3 + (min(28, len(cells[c.key].text)) if not c.number else len(cells[c.key].text))
                for c in part
                if c.key != "name"
            )
            + 3
            + len("row 0")
        )
        assert across <= width or len(split) <= 1
        assert markdown(table(columns, cells)).count("### T") == 1
