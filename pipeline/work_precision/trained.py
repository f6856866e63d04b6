"""A trained model as a workload: what a run folder holds, seen as its scene's middle test view."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

from omegaconf import OmegaConf

from pipeline.checkpoint import load_model
from pipeline.config import Config
from pipeline.configure import to_config
from pipeline.prepare import prepare
from rasterizer import Request
from rasterizer.bench.workloads import Workload


def workload_of(folder: Path, say: Callable[[str], None]) -> Workload:
    """The run's last Gaussians, over black and without an environment map. Reads the scene the run was trained on.

    Raises ValueError, one line, where the folder holds no training or the near plane is not the benchmark's.
    """
    for name in ("config.yaml", "checkpoint.safetensors"):
        if not (folder / name).exists():
            raise ValueError(f"{folder}: expected a trained run with {name}, found none")
    cfg = to_config(OmegaConf.merge(OmegaConf.structured(Config), OmegaConf.load(folder / "config.yaml")))
    scene = prepare(cfg, say).scene
    if not math.isclose(near := cfg.scene.near * scene.unit, Request.near):
        raise ValueError(f"{folder}: expected a near plane at {Request.near}, as the benchmark's, found {near}")
    view = scene.test[len(scene.test) // 2]
    gaussians = load_model(folder / "checkpoint.safetensors").gaussians()
    return Workload(gaussians, view.camera, view.time, scene.duration)
