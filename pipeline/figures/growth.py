"""Number of Gaussians against the length of the video: how many of a model its first t need, and how many a frame."""

from __future__ import annotations

import numpy as np
import torch

from pipeline.evaluation.renderer import Renderer
from pipeline.figures.figure import Figure, canvas, png_of
from pipeline.presentation.theme import LIGHT
from rasterizer.covariance import temporal_deviation
from rasterizer.reference.blend import MIN_MARGINAL

STEPS = 200


def growth_figure(renderer: Renderer) -> Figure:
    """Of a model with time. Counted by p(t) >= 0.05, whether or not a camera sees the Gaussian."""
    scene = renderer.scene
    times = np.linspace(scene.time_start, scene.time_end, STEPS)
    seen_until, alive = counts(renderer, times)
    elapsed = times - scene.time_start
    figure = canvas(7.2, 3.2)
    axis = figure.subplots()
    axis.plot(elapsed, seen_until, color=LIGHT.ablations[0], label="alive at some time of the first t")
    axis.plot(elapsed, alive, color=LIGHT.ablations[1], label="alive at t")
    axis.set(xlabel="t since the start", ylabel="Gaussians", ylim=(0, None))
    axis.grid(color=LIGHT.faint, lw=0.7)
    axis.legend(frameon=False)
    half = seen_until[STEPS // 2] / max(1, seen_until[-1])
    seen = (
        f"The first half of the scene uses {half:.0%} of its {seen_until[-1]:,} Gaussians, a frame {alive.mean():,.0f} "
        "on average."
    )
    return Figure("growth", "Gaussians against the length of the video", seen, png_of(figure))


def counts(renderer: Renderer, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(alive at any time from the first of `times` to each, alive at each), both (T,)."""
    gaussians = renderer.model.gaussians()
    reach = temporal_deviation(gaussians) * float(np.sqrt(-2 * np.log(MIN_MARGINAL)))
    first, last = gaussians.mean[:, 3] - reach, gaussians.mean[:, 3] + reach
    begun = torch.sort(first).values.numpy()
    ended = torch.sort(last).values.numpy()
    started = np.searchsorted(begun, times, side="right")
    over = np.searchsorted(ended, times, side="left")
    return started - over[0], started - over
