"""Target datasets/readers/colmap.py: a model as binary files, and one as text."""

from __future__ import annotations

from pathlib import Path

from layout_folders import write_colmap

from fuzz.edits.bytes import edit_text
from fuzz.layout_target import layout_target


def write(folder: Path) -> None:
    write_colmap(folder / "binary", True, "OPENCV", (0.01, 0.0, 0.0, 0.0), count=4)
    write_colmap(folder / "text", False, count=4)


TARGET = layout_target("colmap", "COLMAP's folder, binary and text", write, {".txt": edit_text}, ("binary", "text"))
