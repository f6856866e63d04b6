"""The command line that all studies share: parser with --out, one-line errors, provenance of a result."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path

from pipeline.runs.provenance import provenance
from pipeline.terminal.command_line import CommandParser, log
from pipeline.terminal.command_line import command as study_command

__all__ = ["Provenance", "StudyParser", "log", "study_command"]


class StudyParser(CommandParser):
    """Parser of `python -m pipeline.studies.<name>`; its description is the first line of `doc`."""

    def __init__(self, name: str, doc: str) -> None:
        super().__init__(prog=f"python -m pipeline.studies.{name}", description=doc.splitlines()[0])
        self.add_argument(
            "--out",
            type=Path,
            default=Path("results") / name,
            metavar="DIR",
            help="folder of the results (default: %(default)s)",
        )


@dataclass(frozen=True)
class Provenance:
    """What a result was measured with."""

    machine: str
    date: str  # ISO 8601
    commit: str
    command: str

    @classmethod
    def of(cls, name: str, arguments: list[str]) -> Provenance:
        command = shlex.join(["python", "-m", f"pipeline.studies.{name}", *arguments])
        found = provenance(command)
        return cls(found["machine"], found["date"], found["git_commit"], command)

    def __str__(self) -> str:
        return f"{self.machine}; {self.date[:16]}; commit {self.commit[:10]}; `{self.command}`"

    def short(self) -> str:
        """For the title of a plot."""
        return f"{self.machine}, {self.date[:10]}"
