"""Target datasets/layouts/nerfstudio.py: transforms.json, masks and a .ply."""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path

from hypothesis.strategies import SearchStrategy
from layout_folders import write_nerfstudio

from fuzz.edits.bytes import changed_files, edit_text
from fuzz.edits.json import edit_json
from fuzz.scene_checks import check_layout
from fuzz.target import Changes, Files, Target, read_files, valid_or_refused


@cache
def example() -> Files:
    with tempfile.TemporaryDirectory() as folder:
        write_nerfstudio(Path(folder), count=4)
        return read_files(Path(folder))


def changes(files: Files) -> SearchStrategy[Changes]:
    return changed_files(files, {".json": edit_json, ".ply": edit_text})


def check(folder: Path) -> str:
    with valid_or_refused(folder) as outcome:
        check_layout("nerfstudio", folder)
    return outcome[0]


TARGET = Target("nerfstudio", "nerfstudio's folder", example, changes, check)
