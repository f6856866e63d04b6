"""The test view that shows most motion, which most figures are drawn of."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from datasets.ground_truth import GroundTruth
from pipeline.data.optical_flow import measure_flow, neighbours, resized_flow
from pipeline.data.training_views import Target, target_of
from pipeline.evaluation.motion.moving_pixels import MovingPixels
from pipeline.evaluation.renderer import Renderer

CANDIDATES = 60  # test views looked at, evenly spread

TRUE, MEASURED = "true", "OpenCV's"  # whose flow a GroundTruth has


@dataclass(frozen=True)
class MovingView:
    """A test view at the final resolution."""

    target: Target
    index: int  # among the test views
    moving: np.ndarray | None  # (H, W) bool; None: unknown
    known: GroundTruth | None  # with flow, if `source` is not None
    source: str | None  # of the flow: TRUE, MEASURED, or None: there is none

    @property
    def truth(self) -> np.ndarray:
        """(H, W, 3) in [0, 1]."""
        return self.target.image.numpy().transpose(1, 2, 0)


def most_moving(renderer: Renderer) -> MovingView:
    """The test view with most moving pixels; the middle one where it is unknown what moves."""
    scene, scale = renderer.scene, renderer.cfg.train.resolution_scale
    pixels, views = MovingPixels(scene, scale), scene.test
    following = neighbours(views, max_gap=scene.duration)  # what is too far to follow is not trusted
    indices = np.unique(np.linspace(0, len(views) - 1, min(len(views), CANDIDATES)).round().astype(int)).tolist()
    counts = {i: 0 if (mask := pixels.of(i)) is None else int(mask.sum()) for i in indices}
    middle = len(views) / 2
    best = max(indices, key=lambda i: (counts[i], -abs(i - middle)))
    target, known = target_of(views[best], scale), pixels.truth_of(best)
    moving = pixels.of(best, known)
    if known is not None and known.flow is not None:
        return MovingView(target, best, moving, known, TRUE)
    if best not in following:
        return MovingView(target, best, moving, known, None)
    other = views[following[best]]
    flow = resized_flow(
        measure_flow(np.asarray(views[best].image), np.asarray(other.image)), target.camera.width, target.camera.height
    ).numpy()
    found = replace(
        known or GroundTruth(),
        flow=np.nan_to_num(flow) * target.camera.width,
        flow_valid=np.isfinite(flow[0]),
        flow_dt=other.time - views[best].time,
    )
    return MovingView(target, best, moving, found, MEASURED)
