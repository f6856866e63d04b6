"""What a fuzz target is, and the rule that holds for every reader."""

from __future__ import annotations

import shutil
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from hypothesis.strategies import SearchStrategy

Files = dict[str, bytes]  # path in a folder -> content
Changes = dict[str, "bytes | None"]  # likewise, of the files that differ from the example's; None: it is not there

LONGEST_LINE = 2000  # characters of a message
DELETED = ".deleted"  # in a kept input, behind the name of a file that is not there
# What another program would have printed before our line. Those of Python's own future are not the user's.
SILENT = (DeprecationWarning, PendingDeprecationWarning, FutureWarning, ResourceWarning)

VALID, REFUSED = "valid", "refused"  # what a check may find


class RuleBroken(AssertionError):
    """A case that breaks its target's rule; the message says how."""


@dataclass(frozen=True)
class Target:
    """One thing to fuzz. Its functions are a module's, so that another process can be given them."""

    name: str
    about: str  # one line
    example: Callable[[], Files]  # valid; the same at each call
    changes: Callable[[Files], SearchStrategy[Changes]]  # of the example
    check: Callable[[Path], str]  # of a folder with the case's files; VALID or REFUSED, or raises
    limit: float = 60.0  # seconds a case may take: milliseconds, but the machine may be busy


def write_files(folder: Path, files: Mapping[str, bytes | None]) -> None:
    """Make `folder` anew, holding these files and nothing else."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    for name, content in files.items():
        if content is not None:
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(content)


def read_files(folder: Path) -> Files:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()
    }


def keep_changes(folder: Path, changes: Changes) -> None:
    """An input as it is kept: the files that differ from the example's."""
    write_files(
        folder, {f"{name}{DELETED}" if content is None else name: content or b"" for name, content in changes.items()}
    )


def kept_changes(folder: Path) -> Changes:
    """What `keep_changes` wrote."""
    return {
        name.removesuffix(DELETED): None if name.endswith(DELETED) else content
        for name, content in read_files(folder).items()
    }


@contextmanager
def valid_or_refused(folder: Path) -> Iterator[list[str]]:
    """Run a reader in this block: what it raises must be one line of the project's own that names a file in `folder`.

    Yields a list, which holds REFUSED after a refusal. Warnings are errors: they would stand before the line.
    """
    outcome = [VALID]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            for category in SILENT:
                warnings.simplefilter("ignore", category)
            yield outcome
    except ValueError as error:
        check_line(str(error), str(folder))
        outcome[0] = REFUSED


def check_line(line: str, named: str, *words: str) -> None:
    """RuleBroken unless `line` is one a user can read, has `named` in it, and says what was expected and found."""
    words = words or ("expected", "found")
    if not line.isprintable() or len(line) > LONGEST_LINE:
        raise RuleBroken(f"not one line of printable text: {line[:LONGEST_LINE]!r}")
    if named not in line or not all(word in line for word in words):
        raise RuleBroken(f"a refusal that does not say {', '.join((named, *words))}: {line}")


def require(condition: bool, what: str) -> None:
    """RuleBroken, "accepted, but …", where a result that passed for valid is not."""
    if not condition:
        raise RuleBroken(f"accepted, but {what}")
