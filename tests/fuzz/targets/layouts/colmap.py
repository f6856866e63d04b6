"""Target datasets/layouts/colmap.py: a model as binary files, and one as text."""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path

from hypothesis.strategies import SearchStrategy
from layout_folders import write_colmap

from fuzz.edits.bytes import changed_files, edit_text
from fuzz.scene_checks import check_layout
from fuzz.target import Changes, Files, Target, read_files, valid_or_refused


@cache
def example() -> Files:
    with tempfile.TemporaryDirectory() as folder:
        write_colmap(Path(folder) / "binary", True, "OPENCV", (0.01, 0.0, 0.0, 0.0), count=4)
        write_colmap(Path(folder) / "text", False, count=4)
        return read_files(Path(folder))


def changes(files: Files) -> SearchStrategy[Changes]:
    return changed_files(files, {".txt": edit_text})


def check(folder: Path) -> str:
    with valid_or_refused(folder) as outcome:
        for form in ("binary", "text"):
            check_layout("colmap", folder / form)
    return outcome[0]


TARGET = Target("colmap", "COLMAP's folder, binary and text", example, changes, check)
