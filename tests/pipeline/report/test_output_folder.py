"""The output folder: a new report replaces the files of the previous one and leaves all other files."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from report_runs import write_run

from pipeline.report.__main__ import main
from pipeline.report.output_folder import LIST, replace_report


def files(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def put(folder: Path, content: dict[str, bytes]) -> None:
    for name, data in content.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)


def test_new_report_replaces_the_previous_one_and_keeps_other_files(tmp_path) -> None:
    others = {
        "notes.md": b"mine",
        "tables/mine.md": b"mine",
        "plots/mine.svg": b"mine",
        "strips/mine.webp": b"mine",
        "report.pdf": b"mine",
    }
    put(tmp_path, others)
    replace_report(tmp_path, {"report.md": b"1", "tables/a.md": b"1", "plots/a.svg": b"1"})
    replace_report(tmp_path, {"report.md": b"2", "tables/b.md": b"2"})
    found = files(tmp_path)
    assert found.pop(LIST).decode().splitlines()[1:] == ["report.md", "tables/b.md"]
    assert found == others | {"report.md": b"2", "tables/b.md": b"2"}


def test_empty_folder_of_the_previous_report_is_removed(tmp_path) -> None:
    replace_report(tmp_path, {"report.md": b"", "strips/a.webp": b""})
    replace_report(tmp_path, {"report.md": b""})
    assert not (tmp_path / "strips").exists()


@pytest.mark.parametrize("foreign", ["report.md", "report.html", "tables/a.md", LIST])
def test_foreign_file_is_not_overwritten(tmp_path, foreign: str) -> None:
    put(tmp_path, {foreign: b"mine"})
    with pytest.raises(ValueError, match="give another --out") as error:
        replace_report(tmp_path, {"report.md": b"", "report.html": b"", "tables/a.md": b""})
    assert str(error.value).startswith(str(tmp_path / foreign)) and "\n" not in str(error.value)
    assert files(tmp_path) == {foreign: b"mine"}


@pytest.mark.parametrize("in_the_way", ["out", "out/tables"])
def test_file_in_place_of_a_folder_is_an_error(tmp_path, in_the_way: str) -> None:
    put(tmp_path, {in_the_way: b"mine"})
    with pytest.raises(ValueError, match="expected a folder or nothing, found a file"):
        replace_report(tmp_path / "out", {"tables/a.md": b""})
    assert files(tmp_path) == {in_the_way: b"mine"}


@pytest.mark.parametrize("line", ["../mine.md", "/etc/hostname", "tables/../mine.md", "notes.md", "tables/a/b.md", ""])
def test_edited_list_removes_no_other_file(tmp_path, line: str) -> None:
    out = tmp_path / "out"
    replace_report(out, {"report.md": b""})
    others = {"mine.md": b"", "out/mine.md": b"", "out/notes.md": b"", "out/tables/a/b.md": b""}
    put(tmp_path, others)
    with (out / LIST).open("a") as file:
        file.write(f"{line}\n")
    replace_report(out, {"report.md": b""})
    assert files(tmp_path).keys() == others.keys() | {"out/report.md", f"out/{LIST}"}


def test_files_of_an_interrupted_report_are_removed_by_the_next(tmp_path, monkeypatch) -> None:
    replace_report(tmp_path, {"report.md": b"1", "tables/a.md": b"1"})

    def killed(path: Path, data: bytes) -> int:
        if path.name == "c.md":
            raise KeyboardInterrupt
        with path.open("wb") as file:
            return file.write(data)

    with monkeypatch.context() as patched, pytest.raises(KeyboardInterrupt):
        patched.setattr(Path, "write_bytes", killed)
        replace_report(tmp_path, {"report.md": b"2", "tables/b.md": b"2", "tables/c.md": b"2"})
    replace_report(tmp_path, {"report.md": b"3"})
    assert files(tmp_path).keys() == {"report.md", LIST}


def test_files_of_a_deleted_run_are_removed_by_the_next_report(tmp_path) -> None:
    write_run(tmp_path / "runs", "synthetic/wheel", images=2)
    gone = write_run(tmp_path / "runs", "dnerf/lego", images=2)
    main([str(tmp_path / "runs")])
    assert {"tables/table2_dnerf.csv", "plots/dnerf_lego__fast.svg"} <= files(tmp_path / "report").keys()
    shutil.rmtree(gone)
    main([str(tmp_path / "runs")])
    assert not [name for name in files(tmp_path / "report") if "dnerf" in name]


def test_command_reports_a_foreign_file_in_one_line(tmp_path, capsys) -> None:
    write_run(tmp_path / "runs", "synthetic/wheel")
    put(tmp_path / "report", {"report.md": b"# My own"})
    assert main([str(tmp_path / "runs")]) == 1
    printed = capsys.readouterr()
    assert printed.out == "" and printed.err.count("\n") == 1 and "give another --out" in printed.err
    assert files(tmp_path / "report") == {"report.md": b"# My own"}


def test_latex_is_written_on_request_and_removed_by_the_next_report(tmp_path) -> None:
    write_run(tmp_path / "runs", "synthetic/wheel")
    assert main([str(tmp_path / "runs"), "--latex"]) == 0
    tables = {path.stem: path for path in (tmp_path / "report/tables").glob("*.tex")}
    assert {"all_runs", "scenes_synthetic"} <= tables.keys()
    assert r"\begin{tabular}" in tables["all_runs"].read_text()
    assert main([str(tmp_path / "runs")]) == 0
    assert {path.suffix for path in (tmp_path / "report/tables").iterdir()} == {".md", ".csv"}
