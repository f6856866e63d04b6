"""Distribution of the Gaussians' temporal standard deviations, in frames: it falls while a monocular scene overfits."""

from __future__ import annotations

import numpy as np

from datasets.scene import Scene
from pipeline.model.model import Model
from rasterizer.covariance import temporal_deviation

QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
BIN_EDGES = 2.0 ** np.arange(-6, 10.25, 0.25)  # frames, of the histogram


def lifetimes(model: Model, scene: Scene) -> dict[str, list[float] | list[int]] | None:
    """√Σtt divided by the spacing of the training times: `quantiles`, and `counts` in the bins of BIN_EDGES; the first
    and last bin include what is outside. None for a static model.
    """
    if model.kind.dims == 3:
        return None
    frames = temporal_deviation(model.gaussians()).numpy() / scene.frame_spacing
    counts, _ = np.histogram(np.clip(frames, BIN_EDGES[0], BIN_EDGES[-1]), BIN_EDGES)
    return {"quantiles": np.quantile(frames, QUANTILES).tolist(), "counts": counts.tolist()}
