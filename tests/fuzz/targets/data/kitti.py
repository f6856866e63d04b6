"""Target datasets/readers/kitti.py: an odometry sequence and a raw drive, with their text files, sweeps and PNGs."""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path

from hypothesis.strategies import SearchStrategy
from kitti_folder import write_odometry, write_raw

from datasets.readers.kitti import open_kitti
from datasets.settings import SceneConfig
from datasets.urban.assemble import scene_of_log
from fuzz.edits.bytes import changed_files, edit_text
from fuzz.scene_checks import check_scene
from fuzz.target import Changes, Files, Target, read_files, valid_or_refused

FRAMES = 3
DRIVES = ("sequences/04", "2011_09_26/2011_09_26_drive_0001_sync")


@cache
def example() -> Files:
    with tempfile.TemporaryDirectory() as folder:
        write_odometry(Path(folder), FRAMES)
        write_raw(Path(folder), FRAMES)
        return read_files(Path(folder))


def changes(files: Files) -> SearchStrategy[Changes]:
    return changed_files(files, {".txt": edit_text})


def check(folder: Path) -> str:
    with valid_or_refused(folder) as outcome:
        for drive in DRIVES:
            cfg = SceneConfig(name="fuzz/kitti", reader="kitti", test_every=3)
            check_scene(scene_of_log(open_kitti(folder / drive), cfg))
    return outcome[0]


TARGET = Target("kitti", "KITTI: an odometry sequence and a raw drive", example, changes, check)
