"""Reads a finished run again: its configuration, its scene and its final model; or a model from any file with one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from omegaconf.errors import OmegaConfBaseException

from datasets.canonical import Canonical
from datasets.files.errors import read_json
from datasets.scene import Scene
from pipeline.config.compose import config_of_tree, one_line
from pipeline.config.schema import Config
from pipeline.data import stored_scene
from pipeline.data.prepare import prepare
from pipeline.model.model import Model
from pipeline.model.ply import load_ply
from pipeline.model.released_checkpoint import load_released
from pipeline.model.transformed import in_canonical
from pipeline.runs.run_identity import read_config
from pipeline.training.checkpoint import FILE_NAME, load_model
from rasterizer.engine import device_of
from rasterizer.gsplat_rasterizer import NoGpu

SUFFIXES = (".safetensors", ".ply", ".pth")  # of a checkpoint, a model, a checkpoint of the released program


@dataclass(frozen=True)
class TrainedRun:
    cfg: Config
    scene: Scene
    model: Model
    canonical: Canonical  # from the files' coordinates to those of scene and model
    has_images: bool = True  # False: the scene's images are MissingImage


def open_run(
    folder: Path, log: Callable[[str], None], data: Path | None = None, needs_images: bool = True
) -> TrainedRun:
    """Also reads the data set that the run was trained on, or where it is not there any more what the folder has of it.

    data: where the data set is now; None: where it was. needs_images: False: the folder's scene is enough. ValueError,
    one line, where `folder` is no trained run, and where the data set is missing.
    """
    for name in ("config.yaml", FILE_NAME):
        if not (folder / name).exists():
            raise ValueError(f"{folder}: expected a trained run with {name}, found none")
    cfg = _renderable(stored_config(folder), log)
    if data is not None:
        cfg = replace(cfg, scene=replace(cfg.scene, path=str(data)))
    model, place = load_model(folder / FILE_NAME), Path(cfg.scene.path or folder).expanduser()
    if (stored := folder / stored_scene.FILE_NAME).is_file() and not (data or (needs_images and place.exists())):
        if needs_images:
            log(f"{place}: the run's data set is not there; {stored} takes its place, without images (--data: where)")
        return TrainedRun(cfg, stored_scene.read_scene(stored, place), model, stored_canonical(folder), False)
    found = prepare(cfg, log)
    return TrainedRun(cfg, found.scene, model, found.canonical)


def _renderable(cfg: Config, log: Callable[[str], None]) -> Config:
    """With the kernel in place of a GPU that is not here: images differ by rounding (docs/gpu.md)."""
    try:
        device_of(cfg.backend)
    except NoGpu as error:
        log(f"{error}; backend=cpu renders this run")
        return replace(cfg, backend="cpu")
    return cfg


def stored_canonical(folder: Path) -> Canonical:
    """The transform of a run's scene. ValueError, one line, for a canonical.json with another content."""
    path = folder / "canonical.json"
    try:
        return Canonical.from_dict(read_json(path)) if path.exists() else Canonical()
    except (KeyError, TypeError):
        raise ValueError(f"{path}: expected centre, scale, time_origin and time_scale of a run") from None


def stored_config(folder: Path) -> Config:
    """The configuration of a run. ValueError, one line, for a key or a value that today's schema does not have."""
    path = folder / "config.yaml"
    tree = read_config(path)
    try:
        return config_of_tree(tree)
    except (ValueError, OmegaConfBaseException) as error:
        raise ValueError(f"{path}: {one_line(error)}") from None


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
