"""Readers with faults, for the tests of the search. Functions of a module: another process is given them."""

from __future__ import annotations

import os
import time
from pathlib import Path

from hypothesis import strategies as st

from fuzz.target import VALID, Changes, Files, Target

SMALLEST_BAD = b"\x80"


def example() -> Files:
    return {"file": b"good"}


def changes(files: Files) -> st.SearchStrategy[Changes]:
    return st.binary(max_size=20).map(lambda content: {"file": content})


def is_bad(content: bytes) -> bool:
    """A byte above 127: what a reader of text forgets."""
    return any(byte > 127 for byte in content)


def raises(folder: Path) -> str:
    if is_bad((folder / "file").read_bytes()):
        raise ZeroDivisionError
    return VALID


def dies(folder: Path) -> str:
    if is_bad((folder / "file").read_bytes()):
        os.abort()
    return VALID


def stands_still(folder: Path) -> str:
    if is_bad((folder / "file").read_bytes()):
        time.sleep(3600)
    return VALID


RAISES = Target("raises", "an exception of another kind", example, changes, raises)
DIES = Target("dies", "the end of the process", example, changes, dies)
STANDS_STILL = Target("stands still", "no end", example, changes, stands_still, limit=1.0)
