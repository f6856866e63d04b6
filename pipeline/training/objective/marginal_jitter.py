"""Jitter of the temporal marginals: a training view of time t shows the Gaussians that are alive at t + δ, where and as
they are at t. δ is random for each view. Not in the paper.

Where one camera films each moment once, neighbouring times have Gaussians of their own, which fit one image each. With
the jitter the Gaussians of t + δ must explain the image of t too, moved along their straight paths: one image teaches
the Gaussians of neighbouring times, and their velocities. Jitter of the whole view's time, which does not move them,
blurs instead.

A Gaussian that lives for less than the spacing of the training times hardly moves (docs/method.md 5.2). Where many do,
what they show is too fast to be followed from one image to the next, and nothing is jittered.
"""

from __future__ import annotations

import numpy as np

from datasets.scene import Scene
from pipeline.model.model import Model
from rasterizer.covariance import temporal_deviation

# With the jitter a quarter to a third of the Gaussians live so short on synthetic/burst, which it harms, 0.09 on wheel
# and at most 0.08 on D-NeRF's scenes, while they are densified (results/measured/motion/motion.md).
MAX_SHORT_LIVED = 0.2
SAMPLE = 2000  # Gaussians that this share is estimated from: its standard deviation is 0.007


def short_lived_share(model: Model, scene: Scene) -> float:
    """The share of Gaussians with √Σtt < the mean spacing of the training times; of about SAMPLE of them, evenly
    spread over the rows."""
    every = max(1, len(model) // SAMPLE)
    sample = model.gaussians().rows(slice(None, None, every))
    return (temporal_deviation(sample) < scene.frame_spacing).float().mean().item()


def draw_offsets(count: int, jitter: float, model: Model, scene: Scene, rng: np.random.Generator) -> list[float]:
    """δ of `count` views, in units of time: uniform in ± `jitter` × the mean spacing of the training times, or zero
    where more than MAX_SHORT_LIVED of the Gaussians live for less than that."""
    if short_lived_share(model, scene) > MAX_SHORT_LIVED:
        return [0.0] * count
    width = jitter * scene.frame_spacing
    return rng.uniform(-width, width, count).tolist()
