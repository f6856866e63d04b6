"""Errors for invalid files: one printable line with the file or key, what was expected and what was found."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

LONGEST_PART = 400  # characters of a message's part: a file may hold a name or a number of a million


class DataError(ValueError):
    """A file is invalid. One line: the file or key, what was expected, what was found."""

    def __init__(self, where: str | Path, expected: str, found: str | Sequence[str]) -> None:
        """found: several parts are joined and none is left out; long ones lose their middle."""
        parts = [found] if isinstance(found, str) else found
        super().__init__(f"{clear(where)}: expected {clear(expected)}, found {', '.join(map(clear, parts))}")


class SceneError(DataError):
    """A data set on disk does not follow its layout, or a setting of `scene` does not fit it."""


def clear(text: object, longest: int = LONGEST_PART) -> str:
    """`text` as one printable line of at most `longest` characters.

    Whitespace becomes single spaces, control characters are escaped, and the middle of a long text is left out.
    """
    line = " ".join(str(text).split())
    if len(line) > longest:
        line = f"{line[: longest // 2]} … {line[-longest // 2 :]}"
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in line)


def read_json(path: Path, error: type[DataError] = DataError) -> Any:
    """The content of a JSON file. Raises `error` if it is invalid or unreadable, FileNotFoundError if it is absent."""
    try:
        return json.loads(path.read_text(encoding="utf-8-sig"))  # Windows' tools begin a file with a byte-order mark
    except FileNotFoundError:
        raise
    # ValueError: not UTF-8, not JSON, or a number of more than 4300 digits. RecursionError: lists nested too deeply.
    except (ValueError, RecursionError, OSError) as cause:
        raise error(path, "valid JSON", str(cause)) from None
