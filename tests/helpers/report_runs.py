"""Writes run folders in the format of the pipeline, for the tests of the report."""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

PROTOCOLS = {
    "dnerf": "dnerf-400-black-v1",
    "plenoptic": "plenoptic-half-cam00-v1",
    "synthetic": "synthetic-v1",
}  # of a scene's family


def write_run(
    root: Path,
    scene: str,
    model: str = "full",
    recipe: str = "fast",
    seed: int = 0,
    psnr: float = 25.0,
    out: str | None = None,
    iterations: int = 1000,
    images: int = 0,
    settings: str = "",
    scene_settings: str = "",
    changes: Mapping[str, Any] | None = None,
    **values,
) -> Path:
    """A run folder. `values` replace keys of metrics.json; dotted keys are nested.

    changes: as the run declares them. settings, scene_settings: YAML lines for `train` and `scene` in config.yaml,
    indented by two spaces.
    """
    folder = root / (out or f"{scene}/{model}/{recipe}/seed{seed}")
    assert folder.is_relative_to(root), f"{out}: expected a path below {root}"
    (folder / "renders").mkdir(parents=True)
    quality = {
        "psnr": psnr,
        "psnr_channels": psnr + 0.125,
        "ssim": 0.9,
        "ms_ssim": 0.96,
        "dssim": 0.02,
        "dssim1": 0.05,
        "dssim2": 0.04,
        "lpips_alex": None,
        "lpips_vgg": None,
        "lpips_note": "no weights: offline",
        "fps_raster": 80.0,
        "fps_render": 60.0,
    }
    metrics = {
        "final": dict(quality),
        "best_on_test": quality | {"psnr": psnr + 0.25, "iteration": 800},
        "n_gaussians": 12345,
        "n_alive_mean": 6000.5,
        "train_seconds": 60.0 + seed,
        "peak_rss_mb": 512.0,
        "model_mb": 7.5,
        "model_with_optimiser_mb": 22.5,
        "iterations": iterations,
        "protocol": PROTOCOLS.get(scene.split("/")[0], "unnamed-00000000"),
        "images": "rendered",
        "scene": scene,
        "recipe": recipe,
        "model": model,
        "changes": dict(changes or {}),
        "seed": seed,
        "capture": "monocular",
        "kind": {"motion": "full", "fourier_order": 2, "sh_degree": 3},
        "decided": {},
    }
    for key, value in values.items():
        *path, last = key.split(".")
        part = metrics
        for name in path:
            part = part[name]
        part[last] = value
    (folder / "metrics.json").write_text(json.dumps(metrics))
    (folder / "config.yaml").write_text(
        f"seed: {seed}\nthreads: 2\nscene:\n  name: {scene}\n  path: null\n{scene_settings}"
        f"ablation:\n  name: {model}\n"
        f"train:\n  name: {recipe}\n  iterations: {iterations}\n{settings}"
    )
    rows = ["train_seconds,iteration,psnr,ssim,test_loss,n_gaussians"]
    rows += [
        f"{(60 + seed) * k / 4},{iterations * k // 4},{psnr - 8 / k + 2},{0.8},{0.1},{3000 * k}" for k in (1, 2, 3, 4)
    ]
    (folder / "error_vs_time.csv").write_text("\n".join(rows) + "\n")
    arguments = [f"scene={scene}", f"seed={seed}", *(f"{key}={value}" for key, value in (changes or {}).items())]
    environment = {
        "machine": "Test CPU, 2 cores",
        "date": f"2025-01-0{seed + 1}T10:00:00Z",
        "git_commit": "abc1234",
        "command": shlex.join(["python", "-m", "pipeline", *arguments]),
        "versions": {},
    }
    (folder / "environment.json").write_text(json.dumps(environment))
    per_image = ["view,psnr"]
    for i in range(images):
        per_image.append(f"test/r_{i},{psnr + i}")
        for part, shade in (("render", 90), ("truth", 120), ("difference", 30)):
            pixels = np.full((24, 24, 3), shade + i, np.uint8)
            Image.fromarray(pixels).save(folder / "renders" / f"test_r_{i}_{part}.png")
    (folder / "per_image.csv").write_text("\n".join(per_image) + "\n")
    return folder


def write_sfm(folder: Path, picture: bool = True, **changes) -> Path:
    """Adds the files of a run initialised by structure from motion; `changes` replace keys of sfm.json."""
    found = {
        "points": 12345,
        "mean_error_px": 0.625,
        "mean_track_length": 3.5,
        "cameras": 20,
        "registered": 19,
        "seconds": 42.5,
        "poses": "known",
    }
    (folder / "sfm.json").write_text(json.dumps(found | changes))
    if picture:
        Image.fromarray(np.full((60, 80, 3), 77, np.uint8)).save(folder / "sfm.png")
    return folder
