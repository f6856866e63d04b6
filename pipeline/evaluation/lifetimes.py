"""How long Gaussians live, in frames: what sinks while a monocular scene is learnt by heart."""

from __future__ import annotations

import numpy as np

from datasets.scene import Scene
from pipeline.model.model import Model
from rasterizer.covariance import scaled_axes

QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
BIN_EDGES = 2.0 ** np.arange(-6, 10.25, 0.25)  # frames, of the histogram


def lifetimes(model: Model, scene: Scene) -> dict[str, list[float] | list[int]] | None:
    """√Σtt over the spacing of the training times: `quantiles`, and `counts` in BIN_EDGES, what lies outside in the
    first and last; None for a static model.

    Σtt = Σ_j (R_tj s_j)²: without rotation st². Tilted far, a long axis of space reaches into time too.
    """
    if model.kind.dims == 3:
        return None
    frames = scaled_axes(model.gaussians())[:, 3].norm(dim=1).numpy() / scene.frame_spacing
    counts, _ = np.histogram(np.clip(frames, BIN_EDGES[0], BIN_EDGES[-1]), BIN_EDGES)
    return {"quantiles": np.quantile(frames, QUANTILES).tolist(), "counts": counts.tolist()}
