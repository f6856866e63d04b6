"""Where in time the Gaussians of a model live: maps, a histogram of their deviations, their number by time."""

from __future__ import annotations

import numpy as np
import torch
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize

from pipeline.evaluation.pictures.false_colour import value_picture
from pipeline.evaluation.renderer import Renderer
from pipeline.figures.figure import Figure, canvas, png_of, show
from pipeline.figures.motion import MovingView
from pipeline.presentation.theme import LIGHT
from rasterizer.covariance import temporal_deviation
from rasterizer.reference.blend import MIN_MARGINAL

OPAQUE = 0.5  # alpha from which a pixel of a map is valid
STEPS = 200  # times at which Gaussians are counted
BIN_EDGES = 2.0 ** np.arange(-6, 10.25, 0.25)  # frames, of the histogram; the first and last bin hold what is outside


def time_maps_figure(renderer: Renderer, view: MovingView) -> Figure:
    """Of a model with time. Deviations are in frames, of the training times."""
    target, scene = view.target, renderer.scene
    mean, variance, alpha = renderer.time_maps(target.camera, target.time)
    deviation = np.sqrt(np.maximum(variance, 0.0)) / scene.frame_spacing
    distance = np.abs(mean - target.time) / scene.frame_spacing
    opaque = alpha >= OPAQUE
    longest, farthest = (
        float(np.quantile(values[opaque], 0.98)) if opaque.any() else 1.0 for values in (deviation, distance)
    )
    height, width = alpha.shape
    figure = canvas(10.5, 10.5 / 3 * height / width + 0.4)
    axes = figure.subplots(1, 3)
    show(axes[0], f"{target.name}, render", renderer.image(target.camera, target.time))
    maps = (("|mean of μt - t|, frames", distance, farthest), ("√ of the mean of Σtt, frames", deviation, longest))
    for axis, (title, values, high) in zip(axes[1:], maps):
        show(axis, title, value_picture(values, 0.0, high, opaque))
        figure.colorbar(ScalarMappable(Normalize(0.0, high), "viridis"), ax=axis, shrink=0.8)
    return Figure("time_maps", "Where Gaussians live in time", _seen(deviation, opaque, view), png_of(figure))


def _seen(deviation: np.ndarray, opaque: np.ndarray, view: MovingView) -> str:
    moving = None if view.moving is None else opaque & view.moving
    still = None if view.moving is None else opaque & ~view.moving
    if moving is None or still is None or not moving.any() or not still.any():
        median = float(np.median(deviation[opaque])) if opaque.any() else 0.0
        return f"The median deviation in time of what is seen is {median:.1f} frames."
    short, long = float(np.median(deviation[moving])), float(np.median(deviation[still]))
    compared = "live shorter than" if short < long else "do not live shorter than"
    return (
        f"Gaussians on what moves {compared} those on what rests: their median deviation is {short:.1f} frames against "
        f"{long:.1f}."
    )


def lifetimes_figure(renderer: Renderer) -> Figure:
    """Of a model with time."""
    frames = renderer.scene.frame_count
    deviation = temporal_deviation(renderer.model.gaussians()).numpy() / renderer.scene.frame_spacing
    counts, _ = np.histogram(np.clip(deviation, BIN_EDGES[0], BIN_EDGES[-1]), BIN_EDGES)
    figure = canvas(7.2, 3.2)
    axis = figure.subplots()
    axis.stairs(counts, BIN_EDGES, fill=True, color=LIGHT.lines[0])
    axis.axvline(frames, color=LIGHT.lines[1], lw=1.2)
    axis.annotate("the scene", (frames, 1), (4, -12), xycoords=("data", "axes fraction"), textcoords="offset points",
                  color=LIGHT.lines[1])  # fmt: skip
    axis.set(xscale="log", xlabel="√Σtt, frames", ylabel="Gaussians")
    shown = np.flatnonzero(counts)
    axis.set_xlim(min(BIN_EDGES[shown[0]], frames) / 1.2, max(BIN_EDGES[shown[-1] + 1], frames) * 1.2)
    axis.grid(color=LIGHT.faint, lw=0.7)
    axis.set_axisbelow(True)
    low, median, high = np.quantile(deviation, (0.05, 0.5, 0.95))
    seen = (
        f"Half of the {len(renderer.model):,} Gaussians have a deviation in time below {median:.1f} of the scene's "
        f"{frames} frames, and 90 % lie between {low:.1f} and {high:.1f}."
    )
    return Figure("lifetimes", "Lifetimes", seen, png_of(figure))


def growth_figure(renderer: Renderer) -> Figure:
    """Of a model with time. Counted by p(t) >= 0.05, whether or not a camera sees the Gaussian."""
    scene = renderer.scene
    times = np.linspace(scene.time_start, scene.time_end, STEPS)
    seen_until, alive = counts_over(renderer, times)
    elapsed = times - scene.time_start
    figure = canvas(7.2, 3.2)
    axis = figure.subplots()
    axis.plot(elapsed, seen_until, color=LIGHT.lines[0], label="alive at some time of the first t")
    axis.plot(elapsed, alive, color=LIGHT.lines[1], label="alive at t")
    axis.set(xlabel="t since the start", ylabel="Gaussians", ylim=(0, None))
    axis.grid(color=LIGHT.faint, lw=0.7)
    axis.legend(frameon=False)
    half = seen_until[STEPS // 2] / max(1, seen_until[-1])
    seen = (
        f"The first half of the scene uses {half:.0%} of its {seen_until[-1]:,} Gaussians, a frame {alive.mean():,.0f} "
        "on average."
    )
    return Figure("growth", "Gaussians against the length of the video", seen, png_of(figure))


def counts_over(renderer: Renderer, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(alive at any time from the first of `times` to each, alive at each), both (T,)."""
    gaussians = renderer.model.gaussians()
    reach = temporal_deviation(gaussians) * float(np.sqrt(-2 * np.log(MIN_MARGINAL)))
    first, last = gaussians.mean[:, 3] - reach, gaussians.mean[:, 3] + reach
    begun = torch.sort(first).values.numpy()
    ended = torch.sort(last).values.numpy()
    started = np.searchsorted(begun, times, side="right")
    over = np.searchsorted(ended, times, side="left")
    return started - over[0], started - over
