"""What is raised for a file that is not what it should be: one line of plain text, whatever the file holds."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

LONGEST_PART = 400  # characters; a file may hold a name or a number of a million


class DataError(ValueError):
    """A file is not what it should be. One line: the file or key, what was expected, what was found."""

    def __init__(self, where: str | Path, expected: str, found: str) -> None:
        super().__init__(f"{clear(where)}: expected {clear(expected)}, found {clear(found)}")


def clear(text: object, longest: int = LONGEST_PART) -> str:
    """A text as it can be printed in one line: spaces for line ends, escapes for what a terminal would obey or cannot
    show, and no more than `longest` characters, of which the middle ones are left out."""
    line = " ".join(str(text).split())
    if len(line) > longest:
        line = f"{line[: longest // 2]} … {line[-longest // 2 :]}"
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in line)


def read_json(path: Path, error: type[DataError] = DataError) -> Any:
    """What a JSON file holds. Raises `error` for what is none or cannot be read, FileNotFoundError for none at all."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise
    except (ValueError, RecursionError, OSError) as fault:  # no text, no JSON, a number of 5,000 digits; too deep
        raise error(path, "valid JSON", str(fault)) from None
