"""The coordinates of a .ply file that does not state them: canonical, as this program's, or the data's, as others'."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch

from datasets.outliers import without_outliers
from pipeline.config.schema import Config
from pipeline.data.prepare import Prepared
from pipeline.data.training_views import evenly_spaced, target_of
from pipeline.evaluation.image_metrics import psnr
from pipeline.evaluation.renderer import Renderer
from pipeline.model.model import Model
from pipeline.model.transformed import in_canonical
from rasterizer import engine_for

MIDDLE = (0.1, 0.9)  # quantiles of the Gaussians that tell where they are
SMALLEST, LARGEST = 0.02, 50.0  # × half the side of the scene's cube: half the side of the Gaussians'
VIEWS = 4  # training views that decide where both fit
SURE = 0.3  # dB between the two
NAMES = {"canonical": "canonical coordinates", "data": "the coordinates of the data's files"}


def placed(
    model: Model,
    positions: np.ndarray,
    path: Path,
    cfg: Config,
    data: Prepared,
    threads: int,
    log: Callable[[str], None],
) -> Model:
    """`model`, as the file has it, in canonical coordinates of the scene. positions: (N, 3) float64, the file's.

    Its Gaussians must lie in the scene's cube in one of the two; where they do in both, training views decide. What was
    taken is said. ValueError, with the numbers, where neither fits or both fit alike.
    """
    if data.canonical.is_identity:
        return model
    tried = {"canonical": model, "data": in_canonical(model, data.canonical)}
    mean = tried["data"].parameters["mean"]  # before it was rounded to float32, which map coordinates do not bear
    mean[:, :3] = torch.from_numpy(data.canonical.points(positions)).to(mean.dtype)
    fitting = {name: moved for name, moved in tried.items() if _fits(moved, data)}
    where = {name: _where(moved) for name, moved in tried.items()}
    if not fitting:
        raise ValueError(
            f"{path}: expected Gaussians about the scene, which is at {_text(*_scene_cube(data))} (canonical), found "
            f"them at {where['canonical']}; if they have the coordinates of the data's files, at {where['data']}"
        )
    found, how = next(iter(fitting)), "the others would be far from the scene"
    if len(fitting) == 2:
        decibels = {name: _train_psnr(moved, cfg, data, threads) for name, moved in fitting.items()}
        how = ", ".join(f"{value:.2f} dB as {NAMES[name]}" for name, value in decibels.items())
        how += f" on {VIEWS} training views"
        found = max(decibels, key=lambda name: decibels[name])
        if abs(decibels["canonical"] - decibels["data"]) < SURE:
            raise ValueError(f"{path}: expected --coordinates canonical or data, as both fit alike: {how}")
    log(f"evaluate: {path.name} is taken to have {NAMES[found]}: {how} (--coordinates says otherwise)")
    return fitting[found]


def _fits(model: Model, data: Prepared) -> bool:
    """Whether the middle of the Gaussians overlaps the scene's cube, and is neither a dot nor the sky."""
    (centre, half), (own, own_half) = _scene_cube(data), _cube(model)
    near = bool((np.abs(own - centre) <= half + own_half).all())
    return near and SMALLEST * half <= own_half <= LARGEST * half


def _scene_cube(data: Prepared) -> tuple[np.ndarray, float]:
    """(middle, half side), canonical, of the cube around cameras and initial points."""
    cameras = without_outliers(np.stack([view.camera.position for view in data.scene.train]))
    corners = [np.broadcast_to(corner, 3) for corner in data.scene.init_box]
    positions = np.concatenate([cameras, corners])
    low, high = positions.min(axis=0), positions.max(axis=0)
    return 0.5 * (low + high), 0.5 * float((high - low).max())


def _cube(model: Model) -> tuple[np.ndarray, float]:
    low, high = np.quantile(model.parameters["mean"][:, :3].numpy().astype(np.float64), MIDDLE, axis=0)
    return 0.5 * (low + high), 0.5 * float((high - low).max())


def _where(model: Model) -> str:
    return _text(*_cube(model))


def _text(middle: np.ndarray, half: float) -> str:
    return f"({', '.join(f'{x:.4g}' for x in middle)}) ± {half:.3g}"


def _train_psnr(model: Model, cfg: Config, data: Prepared, threads: int) -> float:
    """Mean in dB over VIEWS evenly spread training views."""
    renderer, found = Renderer(model, data.scene, cfg, engine_for(cfg.backend, threads)), []
    for index in evenly_spaced(len(data.scene.train), VIEWS):
        target = target_of(data.scene.train[index], cfg.train.resolution_scale)
        truth = target.image.numpy().transpose(1, 2, 0)
        found.append(psnr(renderer.image(target.camera, target.time), truth))
    return float(np.mean(found))
