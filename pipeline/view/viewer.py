"""Writes viewer.html: one file with models, cameras and ground truth, which a browser plays from disk."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from datasets.files.atomic_write import write_text
from datasets.scene import Scene
from pipeline.config.schema import Config
from pipeline.model.model import Model, kind_of
from pipeline.view.cameras import QUALITY, Cameras, cameras_of
from pipeline.view.pack import LIFETIME, POSITION_PX, SH_STEP, Packed, pack
from pipeline.view.page import page
from rasterizer.reference.render import DILATION

FILE_NAME = "viewer.html"
LOOP_SECONDS = 4.0  # of photographs, whose time has no seconds
MOST_MODELS = 4  # side by side


@dataclass(frozen=True)
class Shown:
    label: str
    model: Model
    psnr: float | None = None  # dB, on the held-out views


def write_viewer(path: Path, shown: Sequence[Shown], scene: Scene, cfg: Config, with_truths: bool = True) -> None:
    """The models side by side, in step. scene, cfg: of the first; the others' views are the same."""
    if not 1 <= len(shown) <= MOST_MODELS:
        raise ValueError(f"{path}: expected 1 to {MOST_MODELS} models side by side, found {len(shown)}")
    packed = [pack(one.model, scene) for one in shown]
    facts = (one.label if one.psnr is None else f"{one.label}: {one.psnr:.2f} dB held out" for one in shown)
    has_time = any(one.model.kind.motion != "static" for one in shown)
    write_text(path, _page(scene, cfg, has_time, [one.label for one in shown], " · ".join(facts), packed, with_truths))


def live_page(label: str, scene: Scene, cfg: Config) -> str:
    """The page of a run that is being trained: it asks its server for the models."""
    has_time = kind_of(scene, cfg).motion != "static"
    return _page(scene, cfg, has_time, [label], f"{label}, in training", packed=[])


def _page(
    scene: Scene,
    cfg: Config,
    has_time: bool,
    labels: Sequence[str],
    facts: str,
    packed: Sequence[Packed],
    with_truths: bool = True,
) -> str:
    """packed: the models; none: of a run that is being trained. has_time: a model has."""
    cameras = cameras_of(scene, cfg.train.resolution_scale, with_truths, renders=cfg.evaluate.renders)
    seconds = scene.played_seconds or LOOP_SECONDS
    up = -np.mean([view.camera.world_to_cam[1, :3] for view in scene.train], axis=0)
    distances = [np.linalg.norm(view.camera.position) for view in scene.train]
    header = {
        "scene": {
            "name": cfg.scene.name,
            "static": scene.capture == "static",
            "has_time": has_time,  # lifetimes and speeds to colour by
            "start": scene.time_start,
            "end": scene.time_end,
            "duration": scene.duration,
            "seconds": seconds,
            "clock": scene.clock,
            "unit": " s" if scene.has_seconds else "",
            "frame_spacing": scene.frame_spacing,
            "background": list(scene.background),
            "near": cfg.scene.near * scene.unit,
            "dilation": DILATION,
            "lifetime": LIFETIME,
            "middle": [0.0, 0.0, 0.0],  # where the cameras look, in canonical coordinates
            "size": float(np.mean(distances)),
            "up": (up / max(float(np.linalg.norm(up)), 1e-12)).tolist(),
            "cameras": cameras.header,
            "reference": 0,  # where a free view begins: the first held-out camera
        },
        "truths": cameras.truths,
        "labels": labels,
        "facts": facts,
        "notes": notes(packed, cameras),
        "models": [one.header for one in packed],
        "live": not packed,
    }
    return page(f"{cfg.scene.name} – 4D Gaussians", header, cameras.data, [one.data for one in packed])


def notes(packed: Sequence[Packed], cameras: Cameras) -> list[str]:
    """How the page's picture differs from the kernel's and its truth from the data, a sentence each."""
    found = [
        f"Positions are rounded to {POSITION_PX} pixels at the depth of one normalised unit, coefficients of colour to "
        f"{SH_STEP}; scales, rotations, times and opacities likewise.",
        "Gaussians are blended in 16-bit floats, also behind a transmittance of 0.0001, where the kernel stops.",
        "At the data set's cameras the picture has their pixels. A free view enlarges the training images' pixels, and "
        "with them the 0.3 px² that every Gaussian is widened by.",
    ]
    for one in packed:
        share = len(one.data) * 4 / 3 / one.header["float32_bytes"]
        found.append(
            f"{one.header['count']:,} of {one.header['trained']:,} Gaussians are stored, those that are ever seen, in "
            f"{100 * share:.0f} % of their size in float32."
        )
    views = sum(len(camera["frames"]) for camera in cameras.header)
    found.append(f"The truth of {len(cameras.truths)} of {views} views is here, as WebP of quality {QUALITY}.")
    return found
