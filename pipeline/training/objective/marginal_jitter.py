"""Jitter of the temporal marginals: a training view of time t shows the Gaussians that are alive at t + δ, where and as
they are at t. δ is random for each view. Not in the paper.

Where one camera films each moment once, neighbouring times have Gaussians of their own, which fit one image each. With
the jitter the Gaussians of t + δ must explain the image of t too, moved along their straight paths: one image teaches
the Gaussians of neighbouring times, and their velocities. Jitter of the whole view's time, which does not move them,
blurs instead.
"""

from __future__ import annotations

import numpy as np

from datasets.scene import Scene


def draw_offsets(count: int, jitter: float, scene: Scene, rng: np.random.Generator) -> list[float]:
    """δ of `count` views, uniform in ± `jitter` × the mean spacing of the training times, in units of time."""
    width = jitter * scene.frame_spacing
    return rng.uniform(-width, width, count).tolist()
