"""What all studies share: the command line, the provenance of a result, and how results are written."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

from datasets.files.atomic_write import atomic_file
from pipeline.runs.provenance import provenance
from pipeline.terminal.command_line import CommandParser
from rasterizer.kernel_loader import source_hash


class StudyParser(CommandParser):
    """Parser of `python -m pipeline.studies.<name>`; its description is the first line of `doc`."""

    def __init__(self, name: str, doc: str) -> None:
        super().__init__(f"studies.{name}", doc.splitlines()[0])
        source_hash()  # now, of the kernel that is loaded: the source may change while a study runs
        out = Path("results") / name
        self.add_argument(
            "--out", type=Path, default=out, metavar="DIR", help=f"folder of the results (default: {out})"
        )


def made_by(name: str, arguments: list[str]) -> str:
    command = shlex.join(["python", "-m", f"pipeline.studies.{name}", *arguments])
    found = provenance(command)
    made = f"{found['machine']}; {found['date'][:16]}; commit {found['git_commit'][:10]}; kernel {source_hash()}"
    return f"{made}; `{command}`"


def write_results(folder: Path, name: str, table: str, files: Mapping[str, str | Callable[[Path], object]]) -> None:
    """Writes the table as name.md and `files` by suffix, each a text or a function that writes to a path; then prints
    the table and the names of the files. Written first: printing stops where a pipe is closed."""
    files = {f"{name}.{suffix}": content for suffix, content in ({"md": table} | dict(files)).items()}
    folder.mkdir(parents=True, exist_ok=True)
    for file, content in files.items():
        with atomic_file(folder / file) as path:
            if isinstance(content, str):
                path.write_text(content, encoding="utf-8")
            else:
                content(path)
    print(f"{table}\nwritten to {folder}: {', '.join(files)}")


def markdown_table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Right-aligned but for the first column."""
    lines = [header, [":--", *["--:"] * (len(header) - 1)], *rows]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines)
