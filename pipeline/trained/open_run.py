"""Reads a finished run again: its configuration, its scene and its final model."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from omegaconf.errors import OmegaConfBaseException

from datasets.canonical import Canonical
from datasets.scene import Scene
from pipeline.config.compose import config_of_tree, one_line
from pipeline.config.schema import Config
from pipeline.data.prepare import prepare
from pipeline.model.model import Model
from pipeline.runs.run_identity import read_config
from pipeline.training.checkpoint import FILE_NAME, load_model


@dataclass(frozen=True)
class TrainedRun:
    cfg: Config
    scene: Scene
    model: Model
    canonical: Canonical  # from the files' coordinates to those of scene and model


def open_run(folder: Path, log: Callable[[str], None]) -> TrainedRun:
    """Also reads the data set that the run was trained on. ValueError, one line, where `folder` is no trained run."""
    for name in ("config.yaml", FILE_NAME):
        if not (folder / name).exists():
            raise ValueError(f"{folder}: expected a trained run with {name}, found none")
    cfg = stored_config(folder)
    data = prepare(cfg, log)
    return TrainedRun(cfg, data.scene, load_model(folder / FILE_NAME), data.canonical)


def stored_config(folder: Path) -> Config:
    """The configuration of a run. ValueError, one line, for a key or a value that today's schema does not have."""
    path = folder / "config.yaml"
    tree = read_config(path)
    try:
        return config_of_tree(tree)
    except (ValueError, OmegaConfBaseException) as error:
        raise ValueError(f"{path}: {one_line(error)}") from None
