"""Target pipeline/model/released_checkpoint.py: checkpoints of the released program."""

from __future__ import annotations

import io
from pathlib import Path

import torch
from hypothesis import strategies as st
from hypothesis.strategies import DrawFn, SearchStrategy

from fuzz.edits.bytes import changed_files, edit_bytes
from fuzz.model_checks import check_model, random_model
from fuzz.target import Changes, Files, Target, require, valid_or_refused
from pipeline.model.released_checkpoint import load_released, released_bytes

ROWS = 2
ODD_NUMBERS = (-1, 0, 3, 4, 10**30, 0.5, float("nan"), "many", None, True, (), {}, [1, 2])
ODD_TENSORS = ((), (0,), (ROWS,), (0, 3), (ROWS, 0, 3), (ROWS, 1), (ROWS, 4), (ROWS, 15, 3), (ROWS, 47, 3), (3, 2, 2))


def example() -> Files:
    """With 4D rotation and without, and a static one."""
    kinds = {"full.pth": ("full", 1, 3), "separable.pth": ("separable", 0, 1), "static.pth": ("static", 0, 2)}
    return {name: released_bytes(random_model(*kind, ROWS, 0)) for name, kind in kinds.items()}  # type: ignore[arg-type]


def edit_checkpoint(draw: DrawFn, content: bytes) -> bytes:
    """Changes bytes, or a field, or the number of fields."""
    if draw(st.booleans()):
        return edit_bytes(draw, content)
    fields, iteration = torch.load(io.BytesIO(content), weights_only=True)
    fields = list(fields)
    for _ in range(draw(st.integers(1, 3))):
        at = draw(st.integers(0, len(fields) - 1))
        if draw(st.booleans()):
            fields[at] = draw(st.sampled_from(ODD_NUMBERS))
        else:
            value = draw(st.sampled_from((0.5, 1e30, float("nan"), float("inf"))))
            dtype = draw(st.sampled_from((torch.float32, torch.float64, torch.int64, torch.bool, torch.complex64)))
            fields[at] = torch.full(draw(st.sampled_from(ODD_TENSORS)), value).to(dtype)
    if draw(st.integers(0, 9)) == 0:
        fields.pop()
    file = io.BytesIO()
    torch.save((tuple(fields), iteration), file)
    return file.getvalue()


def changes(files: Files) -> SearchStrategy[Changes]:
    return changed_files(files, {".pth": edit_checkpoint})


def check(folder: Path) -> str:
    outcomes = []
    for path in sorted(folder.glob("*.pth")):
        with valid_or_refused(folder) as outcome:
            model = load_released(path)
            require(len(model) > 0, "no Gaussian")
            check_model(model)
        outcomes += outcome
    return min(outcomes, default="absent")  # REFUSED if one of them is


TARGET = Target("released", "checkpoints of the released program", example, changes, check)
