"""A trained model as a workload: what a run folder holds, seen as its scene's middle test view."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

from pipeline.studies.open_run import open_run
from rasterizer import Request
from rasterizer.timing.workloads import Workload


def workload_of(folder: Path, log: Callable[[str], None]) -> Workload:
    """The run's last Gaussians, over black and without an environment map. Reads the scene the run was trained on.

    Raises ValueError, one line, where the folder holds no training or the near plane is not the benchmark's.
    """
    run = open_run(folder, log)
    scene = run.scene
    if not math.isclose(near := run.cfg.scene.near * scene.unit, Request.near):
        raise ValueError(f"{folder}: expected a near plane at {Request.near}, as the benchmark's, found {near}")
    view = scene.test[len(scene.test) // 2]
    return Workload(run.model.gaussians(), view.camera, view.time, scene.duration)
