"""The command line that all studies share: parser with --out, one-line errors, provenance of a result."""

from __future__ import annotations

import argparse
import functools
import shlex
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

from pipeline.runs.provenance import provenance
from pipeline.terminal.closed_pipe import quiet_on_closed_pipe


class StudyParser(argparse.ArgumentParser):
    """Parser of `python -m pipeline.studies.<name>`; its description is the first line of `doc`.

    A wrong option prints one line and exits with status 2.
    """

    def __init__(self, name: str, doc: str) -> None:
        super().__init__(prog=f"python -m pipeline.studies.{name}", description=doc.splitlines()[0])
        self.add_argument(
            "--out",
            type=Path,
            default=Path("results") / name,
            metavar="DIR",
            help="folder of the results (default: %(default)s)",
        )

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"error: {message}\n")

    def require(self, condition: bool, option: str, expected: str, found: object) -> None:
        """Ends the program with one line unless `condition` holds."""
        if not condition:
            self.error(f"{option}: expected {expected}, found {found}")


def study_command(main: Callable[[list[str]], int]) -> Callable[..., int]:
    """Decorator of a study's `main(arguments)`; called without arguments it takes those of the command line.

    ValueError and OSError become one line on standard error and exit status 1. A closed pipe ends the program quietly.
    """

    @functools.wraps(main)
    @quiet_on_closed_pipe()
    def command(arguments: list[str] | None = None) -> int:
        try:
            return main(sys.argv[1:] if arguments is None else arguments)
        except BrokenPipeError:
            raise
        except (ValueError, OSError) as error:
            print(f"error: {error}", file=sys.stderr)
            return 1

    return command


def log(line: str) -> None:
    """Progress on standard output, shown at once in a pipe too."""
    print(line, flush=True)


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
