"""Targets with deliberate errors, for the tests of the search. Module-level functions, because they are pickled."""

from __future__ import annotations

import os
import time
from pathlib import Path

from hypothesis import strategies as st

from fuzz.target import VALID, Changes, Files, Target

SMALLEST_INVALID = b"\x80"


def example() -> Files:
    return {"file": b"good"}


def changes(files: Files) -> st.SearchStrategy[Changes]:
    return st.binary(max_size=20).map(lambda content: {"file": content})


def is_invalid(content: bytes) -> bool:
    """Whether a byte is above 127, like text that is not ASCII."""
    return any(byte > 127 for byte in content)


def accepts(folder: Path) -> str:
    return VALID


def raises(folder: Path) -> str:
    if is_invalid((folder / "file").read_bytes()):
        raise ZeroDivisionError
    return VALID


def crashes(folder: Path) -> str:
    if is_invalid((folder / "file").read_bytes()):
        os.abort()
    return VALID


def hangs(folder: Path) -> str:
    if is_invalid((folder / "file").read_bytes()):
        time.sleep(3600)
    return VALID


NEVER_FAILS = Target("accepts", "no error", example, changes, accepts)
RAISES = Target("raises", "another exception", example, changes, raises)
CRASHES = Target("crashes", "a crash", example, changes, crashes)
HANGS = Target("hangs", "a hang", example, changes, hangs, limit=1.0)
