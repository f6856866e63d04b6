"""The figures: PSNR and lifetimes over the schedule, effective view counts, and a grid of rendered images."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import PercentFormatter
from PIL import Image

from pipeline.evaluation.lifetimes import BIN_EDGES
from pipeline.presentation.theme import LIGHT, Theme
from pipeline.studies.output import svg_figure, svg_style, svg_text
from pipeline.studies.overfitting.history import History

_GAP = 6  # pixels between the images of a grid
_STYLE = {"svg.fonttype": "none", "axes.titlesize": 10, "axes.titlelocation": "left"}


def draw(histories: Sequence[History], view_counts: Sequence[np.ndarray], theme: Theme = LIGHT) -> str:
    """SVG text of runs on one scene, one colour for each; the same numbers give the same bytes.

    view_counts: for each run the effective view count of its Gaussians, (N,).
    """
    with svg_style("overfitting", **_STYLE):
        figure = svg_figure(11.0, 6.6, layout="constrained")
        above, below = figure.subfigures(2, 1, squeeze=False, height_ratios=(1.15, 1.0))[:, 0]
        quality, counts = above.subplots(1, 2)
        for run, found, colour in zip(histories, view_counts, itertools.cycle(theme.ablations)):
            progress = run.iteration / run.iteration[-1]
            quality.plot(progress, run.train_psnr, "--", color=colour, lw=1.2)
            quality.plot(progress, run.psnr, color=colour, lw=1.8, label=run.label)
            cumulative = np.arange(1, len(found) + 1) / len(found)
            counts.plot(np.sort(np.maximum(found, 0.5)), cumulative, color=colour, lw=1.8)
        quality.set_title(f"{histories[0].scene}: PSNR, dB; solid: held-out views, dashed: training views")
        quality.set_xlabel("part of the schedule")
        quality.legend(frameon=False, fontsize=8.5)
        counts.set_title("Gaussians up to an effective view count, final model")
        counts.set_xscale("log")
        counts.set_xlabel("effective view count")
        counts.yaxis.set_major_formatter(PercentFormatter(1.0))
        for axis in (quality, counts):
            axis.grid(color=theme.faint, lw=0.7)
        dynamic = [run for run in histories if run.lifetime_counts is not None]
        if dynamic:
            for run, axis in zip(dynamic, below.subplots(1, len(dynamic), sharey=True, squeeze=False)[0]):
                _lifetimes(axis, run)
            below.suptitle(
                "Lifetimes √Σtt in frames: one histogram for each evaluation; line: the median",
                x=0.01,
                ha="left",
                fontsize=10,
            )
        return svg_text(figure)


def _lifetimes(axis: Axes, run: History) -> None:
    """One column for each evaluation, scaled to its largest bin."""
    ends = run.iteration / run.iteration[-1]
    assert run.lifetimes is not None and run.lifetime_counts is not None  # of a dynamic model
    shades = run.lifetime_counts / run.lifetime_counts.max(axis=1, keepdims=True)
    axis.pcolormesh(np.concatenate([[0.0], ends]), BIN_EDGES, shades.T, cmap="Blues", vmin=0, vmax=1, rasterized=True)
    axis.plot(ends - 0.5 * np.diff(ends, prepend=0.0), run.lifetimes[:, 2], color="#d55e00", lw=1.5)
    axis.set_yscale("log")
    axis.set_title(run.label)
    axis.set_xlabel("part of the schedule")


def image_grid(rows: Sequence[Sequence[np.ndarray]]) -> Image.Image:
    """Images (H, W, 3) in [0, 1] of one size, one list for each row, with white gaps."""
    height, width = rows[0][0].shape[:2]
    columns = max(map(len, rows))
    canvas = np.full((len(rows) * (height + _GAP) - _GAP, columns * (width + _GAP) - _GAP, 3), 255, np.uint8)
    for i, row in enumerate(rows):
        for j, image in enumerate(row):
            top, left = i * (height + _GAP), j * (width + _GAP)
            canvas[top : top + height, left : left + width] = np.rint(np.clip(image, 0, 1) * 255)
    return Image.fromarray(canvas)
