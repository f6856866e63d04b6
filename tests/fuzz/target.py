"""Target: a valid example, changes to it, and a check; the rule for readers; files of saved inputs."""

from __future__ import annotations

import shutil
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from hypothesis.strategies import SearchStrategy

Files = dict[str, bytes]  # path in a folder -> content
Changes = dict[str, "bytes | None"]  # only the files that differ from the example; None: missing

LONGEST_LINE = 2000  # characters of a message
DELETED = ".deleted"  # in a saved input, suffix of the name of a missing file
# Warnings that Python does not show by default.
SILENT = (DeprecationWarning, PendingDeprecationWarning, FutureWarning, ResourceWarning)

VALID, REFUSED = "valid", "refused"  # outcomes of a check


class RuleViolation(AssertionError):
    """A case violates its target's rule; the message says how."""


@dataclass(frozen=True)
class Target:
    """One function to fuzz. The fields are module-level functions, because they are pickled."""

    name: str
    about: str  # one line
    example: Callable[[], Files]  # valid and always the same
    changes: Callable[[Files], SearchStrategy[Changes]]  # of the example
    check: Callable[[Path], str]  # of a folder with the case's files; VALID or REFUSED, or raises
    limit: float = 60.0  # seconds per case; usually milliseconds, with a margin for busy machines


def write_files(folder: Path, files: Mapping[str, bytes | None]) -> None:
    """Recreates `folder` with these files."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    for name, content in files.items():
        if content is not None:
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(content)


def read_files(folder: Path) -> Files:
    """All files below `folder`."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()
    }


def save_changes(folder: Path, changes: Changes) -> None:
    """Saves an input: the files that differ from the example."""
    write_files(
        folder, {f"{name}{DELETED}" if content is None else name: content or b"" for name, content in changes.items()}
    )


def load_changes(folder: Path) -> Changes:
    """The input that `save_changes` wrote."""
    return {
        name.removesuffix(DELETED): None if name.endswith(DELETED) else content
        for name, content in read_files(folder).items()
    }


@contextmanager
def valid_or_refused(folder: Path) -> Iterator[list[str]]:
    """For a block that runs a reader: a ValueError must be one line that names a file in `folder`; warnings are errors.

    Yields a list with the outcome, VALID or REFUSED.
    """
    outcome = [VALID]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            for category in SILENT:
                warnings.simplefilter("ignore", category)
            yield outcome
    except ValueError as error:
        check_message(str(error), str(folder))
        outcome[0] = REFUSED


def check_message(line: str, named: str, *words: str) -> None:
    """RuleViolation unless `line` is printable, contains `named`, and contains `words` (expected, found)."""
    words = words or ("expected", "found")
    if not line.isprintable() or len(line) > LONGEST_LINE:
        raise RuleViolation(f"not one line of printable text: {line[:LONGEST_LINE]!r}")
    if named not in line or not all(word in line for word in words):
        raise RuleViolation(f"a message without {', '.join((named, *words))}: {line}")


def require(condition: bool, what: str) -> None:
    """RuleViolation, "accepted, but …", unless the condition holds for an accepted input."""
    if not condition:
        raise RuleViolation(f"accepted, but {what}")
