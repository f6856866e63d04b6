"""Where in time the Gaussians of an image live: maps of the mean of μt and of √Σtt, as in the paper."""

from __future__ import annotations

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize

from pipeline.evaluation.pictures.false_colour import value_picture
from pipeline.evaluation.renderer import Renderer
from pipeline.figures.figure import Figure, canvas, png_of, show
from pipeline.figures.moving_view import MovingView

OPAQUE = 0.5  # alpha from which a pixel counts


def time_maps_figure(renderer: Renderer, view: MovingView) -> Figure:
    """Of a model with time. Deviations are in frames, of the training times."""
    target, scene = view.target, renderer.scene
    mean, variance, alpha = renderer.time_maps(target.camera, target.time)
    deviation = np.sqrt(np.maximum(variance, 0.0)) / scene.frame_spacing
    opaque = alpha >= OPAQUE
    longest = float(np.quantile(deviation[opaque], 0.98)) if opaque.any() else 1.0
    height, width = alpha.shape
    figure = canvas(10.5, 10.5 / 3 * height / width + 0.4)
    axes = figure.subplots(1, 3)
    show(axes[0], f"{target.name}, render", renderer.image(target.camera, target.time))
    maps = (
        ("mean of μt", mean, scene.time_start, scene.time_end),
        ("√ of the mean of Σtt, frames", deviation, 0.0, longest),
    )
    for axis, (title, values, low, high) in zip(axes[1:], maps):
        show(axis, title, value_picture(values, low, high, opaque))
        figure.colorbar(ScalarMappable(Normalize(low, high), "viridis"), ax=axis, shrink=0.8)
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
