"""Target datasets/layouts/dynamic_gaussians.py: train_meta.json and init_pt_cld.npz."""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path

from hypothesis.strategies import SearchStrategy
from layout_folders import write_dynamic_gaussians

from fuzz.edits.arrays import edit_npz
from fuzz.edits.bytes import changed_files
from fuzz.edits.json import edit_json
from fuzz.scene_checks import check_layout
from fuzz.target import Changes, Files, Target, read_files, valid_or_refused


@cache
def example() -> Files:
    with tempfile.TemporaryDirectory() as folder:
        write_dynamic_gaussians(Path(folder), times=2)
        return read_files(Path(folder))


def changes(files: Files) -> SearchStrategy[Changes]:
    return changed_files(files, {".json": edit_json, ".npz": edit_npz})


def check(folder: Path) -> str:
    with valid_or_refused(folder) as outcome:
        check_layout("dynamic_gaussians", folder)
    return outcome[0]


TARGET = Target("dynamic_gaussians", "the folder of Dynamic 3D Gaussians", example, changes, check)
