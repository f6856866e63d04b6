"""Target datasets/layouts/nerfies.py: dataset.json, metadata.json, a camera file for each image, points.npy."""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path

from hypothesis.strategies import SearchStrategy
from layout_folders import write_nerfies

from fuzz.edits.arrays import edit_npy
from fuzz.edits.bytes import changed_files
from fuzz.edits.json import edit_json
from fuzz.scene_checks import check_layout
from fuzz.target import Changes, Files, Target, read_files, valid_or_refused


@cache
def example() -> Files:
    with tempfile.TemporaryDirectory() as folder:
        write_nerfies(Path(folder), count=4)
        return read_files(Path(folder))


def changes(files: Files) -> SearchStrategy[Changes]:
    return changed_files(files, {".json": edit_json, ".npy": edit_npy})


def check(folder: Path) -> str:
    with valid_or_refused(folder) as outcome:
        check_layout("nerfies", folder)
    return outcome[0]


TARGET = Target("nerfies", "the folder of Nerfies, HyperNeRF and DyCheck", example, changes, check)
