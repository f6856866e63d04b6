"""How long Gaussians live, in frames: what sinks while a monocular scene is learnt by heart."""

from __future__ import annotations

import numpy as np

from datasets.scene import Scene
from pipeline.model import Model
from rasterizer.reference import scaled_axes

QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)


def lifetimes(model: Model, scene: Scene) -> list[float] | None:
    """QUANTILES of √Σtt over the spacing of the training times; None for a static model.

    Σtt = Σ_j (R_tj s_j)²: without rotation st². Tilted far, a long axis of space reaches into time too.
    """
    if model.kind.dims == 3:
        return None
    sigma = scaled_axes(model.gaussians())[:, 3].norm(dim=1).numpy()
    return (np.quantile(sigma, QUANTILES) / scene.frame_spacing).tolist()
