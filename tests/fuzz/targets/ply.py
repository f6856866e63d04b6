"""Target pipeline/model/ply.py: .ply files of this project and of 3DGS."""

from __future__ import annotations

import tempfile
from pathlib import Path

import torch
from hypothesis import strategies as st
from hypothesis.strategies import DrawFn, SearchStrategy
from plyfile import PlyData

from fuzz.edits.bytes import changed_files, edit_bytes, edit_text
from fuzz.model_checks import check_model, random_model
from fuzz.target import Changes, Files, Target, require, valid_or_refused
from pipeline.model.ply import load_ply, save_ply

ROWS = 2
END = b"end_header\n"


def example() -> Files:
    """Three kinds of file, read one after the other."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        models = {"static.ply": random_model("static", 0, 1, ROWS, 0), "full.ply": random_model("full", 1, 0, ROWS, 1)}
        for name, model in models.items():
            model.sphere = torch.arange(ROWS) == 1 if name == "full.ply" else None
            save_ply(folder / name, model)
        text = PlyData.read(str(folder / "static.ply"))
        text.text = True
        text.write(str(folder / "text.ply"))
        return {path.name: path.read_bytes() for path in folder.iterdir()}


def edit_ply(draw: DrawFn, content: bytes) -> bytes:
    """Changes lines of the header, or the data."""
    header, end, behind = content.partition(END)
    if draw(st.booleans()):
        return edit_text(draw, header) + end + behind
    return header + end + (edit_bytes if draw(st.booleans()) else edit_text)(draw, behind)


def changes(files: Files) -> SearchStrategy[Changes]:
    return changed_files(files, {".ply": edit_ply})


def check(folder: Path) -> str:
    outcomes = []
    for path in sorted(folder.glob("*.ply")):
        with valid_or_refused(folder) as outcome:
            model = load_ply(path)
            require(len(model) > 0, "no Gaussian")
            check_model(model)
        outcomes += outcome
    return min(outcomes, default="absent")  # REFUSED if one of them is


TARGET = Target("ply", ".ply files of this project and of 3DGS, binary and text", example, changes, check)
