"""Reads a model from any file that holds one: a checkpoint of this program or of the released one, or a .ply file."""

from __future__ import annotations

from pathlib import Path

from datasets.canonical import Canonical
from pipeline.model.model import Model
from pipeline.model.ply import load_ply
from pipeline.model.released_checkpoint import load_released
from pipeline.model.transformed import in_canonical
from pipeline.training.checkpoint import load_model

SUFFIXES = (".safetensors", ".ply", ".pth")


def read_model(path: Path, canonical: Canonical) -> Model:
    """The model in canonical coordinates. ValueError, one line, for a file of another kind or content.

    canonical: of the model's scene. Only .pth files, the released program's, have the coordinates of the data's files;
    the others are this program's and canonical.
    """
    if path.suffix not in SUFFIXES:
        raise ValueError(
            f"{path}: expected a file of a model ({', '.join(SUFFIXES)}), found {path.suffix or 'no suffix'}"
        )
    if not path.is_file():
        raise ValueError(f"{path}: expected a file of a model, found none")
    if path.suffix == ".safetensors":
        return load_model(path)
    if path.suffix == ".ply":
        return load_ply(path)
    return in_canonical(load_released(path), canonical)
