"""What all studies share: the command line, the provenance of a result, and how results are written."""

from __future__ import annotations

import csv
import io
import shlex
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

from datasets.files.atomic_write import atomic_file
from pipeline.runs.provenance import provenance
from pipeline.terminal.command_line import CommandParser


class StudyParser(CommandParser):
    """Parser of `python -m pipeline.studies.<name>`; its description is the first line of `doc`."""

    def __init__(self, name: str, doc: str) -> None:
        super().__init__(f"studies.{name}", doc.splitlines()[0])
        out = Path("results") / name
        self.add_argument(
            "--out", type=Path, default=out, metavar="DIR", help=f"folder of the results (default: {out})"
        )


def made_by(name: str, arguments: list[str]) -> str:
    """Machine, date, commit and command of a result."""
    command = shlex.join(["python", "-m", f"pipeline.studies.{name}", *arguments])
    found = provenance(command)
    return f"{found['machine']}; {found['date'][:16]}; commit {found['git_commit'][:10]}; `{command}`"


def write_results(folder: Path, files: Mapping[str, str | Callable[[Path], object]]) -> str:
    """Replaces each file, given as its text or as a function that writes to a path; returns the line that names them.

    To be called before anything is printed: printing stops where a pipe is closed.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        with atomic_file(folder / name) as path:
            if isinstance(content, str):
                path.write_text(content, encoding="utf-8")
            else:
                content(path)
    return f"written to {folder}: {', '.join(files)}"


def csv_text(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    return buffer.getvalue()


def markdown_table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Right-aligned but for the first column."""
    lines = [header, [":--", *["--:"] * (len(header) - 1)], *rows]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines)
