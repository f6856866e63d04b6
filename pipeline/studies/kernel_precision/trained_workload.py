"""A trained model as a workload: the final Gaussians of a run, from its scene's middle test view."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

from pipeline.trained.open_run import open_run
from rasterizer import Request
from rasterizer.timing.workloads import Workload


def trained_workload(folder: Path, log: Callable[[str], None]) -> Workload:
    """The workload of a run folder, over black and without the environment map. Also reads the run's data set.

    ValueError, one line, where `folder` is no trained run or its near plane is not the benchmark's.
    """
    run = open_run(folder, log)
    scene = run.scene
    if not math.isclose(near := run.cfg.scene.near * scene.unit, Request.near):
        raise ValueError(f"{folder}: expected a near plane at {Request.near}, as the benchmark's, found {near}")
    view = scene.test[len(scene.test) // 2]
    return Workload(run.model.gaussians(), view.camera, view.time, scene.duration)
