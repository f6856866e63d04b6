"""layout_target(): a Target of a folder that another tool wrote, as scene=auto reads it."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from functools import cache, partial
from pathlib import Path

from hypothesis.strategies import SearchStrategy

from fuzz.edits.bytes import changed_files
from fuzz.scene_checks import check_layout
from fuzz.target import Changes, Files, Target, read_files, valid_or_refused


def layout_target(
    layout: str,
    about: str,
    write: Callable[[Path], object],
    edits: Mapping[str, Callable],
    folders: tuple[str, ...] = ("",),
) -> Target:
    """layout: value of scene.reader, and the target's name. edits: suffix of a file -> how its content is changed.

    write: makes the example in a folder; a module's function or a partial of one, as it is pickled. folders: below the
    one written, each of which is read.
    """
    return Target(layout, about, partial(_example, write), partial(_changes, edits), partial(_check, layout, folders))


@cache
def _example(write: Callable[[Path], object]) -> Files:
    with tempfile.TemporaryDirectory() as folder:
        write(Path(folder))
        return read_files(Path(folder))


def _changes(edits: Mapping[str, Callable], files: Files) -> SearchStrategy[Changes]:
    return changed_files(files, dict(edits))


def _check(layout: str, folders: tuple[str, ...], folder: Path) -> str:
    with valid_or_refused(folder) as outcome:
        for name in folders:
            check_layout(layout, folder / name)
    return outcome[0]
