"""Target datasets/layouts/llff.py: images and poses_bounds.npy of one camera."""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path

from hypothesis.strategies import SearchStrategy
from layout_folders import write_llff

from fuzz.edits.arrays import edit_npy
from fuzz.edits.bytes import changed_files
from fuzz.scene_checks import check_layout
from fuzz.target import Changes, Files, Target, read_files, valid_or_refused


@cache
def example() -> Files:
    with tempfile.TemporaryDirectory() as folder:
        write_llff(Path(folder), count=4)
        return read_files(Path(folder))


def changes(files: Files) -> SearchStrategy[Changes]:
    return changed_files(files, {".npy": edit_npy})


def check(folder: Path) -> str:
    with valid_or_refused(folder) as outcome:
        check_layout("llff", folder)
    return outcome[0]


TARGET = Target("llff", "images of one moving camera with poses_bounds.npy", example, changes, check)
