"""Histogram of the Gaussians' deviations in time."""

from __future__ import annotations

import numpy as np

from pipeline.evaluation.lifetimes import BIN_EDGES, QUANTILES, lifetimes
from pipeline.evaluation.renderer import Renderer
from pipeline.figures.figure import Figure, canvas, png_of
from pipeline.presentation.theme import LIGHT


def lifetimes_figure(renderer: Renderer) -> Figure:
    """Of a model with time."""
    found = lifetimes(renderer.model, renderer.scene)
    assert found is not None
    frames = renderer.scene.frame_count
    figure = canvas(7.2, 3.2)
    axis = figure.subplots()
    axis.stairs(found["counts"], BIN_EDGES, fill=True, color=LIGHT.ablations[0])
    axis.axvline(frames, color=LIGHT.ablations[1], lw=1.2)
    axis.annotate("the scene", (frames, 1), (4, -12), xycoords=("data", "axes fraction"), textcoords="offset points",
                  color=LIGHT.ablations[1])  # fmt: skip
    axis.set(xscale="log", xlabel="√Σtt, frames", ylabel="Gaussians")
    shown = np.flatnonzero(found["counts"])
    axis.set_xlim(BIN_EDGES[shown[0]] / 1.2, max(BIN_EDGES[shown[-1] + 1], frames) * 1.2)
    axis.grid(color=LIGHT.faint, lw=0.7)
    axis.set_axisbelow(True)
    low, median, high = (found["quantiles"][QUANTILES.index(q)] for q in (0.05, 0.5, 0.95))
    seen = (
        f"Half of the {len(renderer.model):,} Gaussians have a deviation in time below {median:.1f} of the scene's "
        f"{frames} frames, and 90 % lie between {low:.1f} and {high:.1f}."
    )
    return Figure("lifetimes", "Lifetimes", seen, png_of(figure))
