"""The figures: seen and unseen PSNR and lifetimes as training goes on; one moment from a seen and an unseen place."""

from __future__ import annotations

import io
from collections.abc import Sequence

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter
from PIL import Image

from pipeline.evaluation.lifetimes import BIN_EDGES
from pipeline.presentation.theme import LIGHT, Theme
from pipeline.studies.overfitting.history import History

_GAP = 6  # pixels between pictures


def draw(histories: Sequence[History], views: Sequence[np.ndarray], theme: Theme = LIGHT) -> str:
    """SVG text of runs on one scene, a colour a run; the same numbers give the same bytes.

    views: of each run's Gaussians the effective number of training views that have seen them, (N,).
    """
    with matplotlib.rc_context(
        {
            "svg.hashsalt": "generalisation",
            "svg.fonttype": "none",
            "font.family": "DejaVu Sans",
            "font.size": 9.5,
            "axes.titlesize": 10,
            "axes.titlelocation": "left",
        }
    ):
        figure = Figure(figsize=(11.0, 6.6), facecolor="white", layout="constrained")
        FigureCanvasSVG(figure)
        above, below = figure.subfigures(2, 1, height_ratios=(1.15, 1.0))
        quality, seen = above.subplots(1, 2)
        for run, found, colour in zip(histories, views, theme.ablations, strict=False):
            done = run.iteration / run.iteration[-1]
            quality.plot(done, run.train_psnr, "--", color=colour, lw=1.2)
            quality.plot(done, run.psnr, color=colour, lw=1.8, label=run.label)
            seen.plot(np.sort(np.maximum(found, 0.5)), np.arange(1, len(found) + 1) / len(found), color=colour, lw=1.8)
        quality.set_title(f"{histories[0].scene}: PSNR, dB; solid: held-out views, dashed: training views")
        quality.set_xlabel("part of the schedule")
        quality.legend(frameon=False, fontsize=8.5)
        seen.set_title("Gaussians seen by at most so many training views, at the end")
        seen.set_xscale("log")
        seen.set_xlabel("effective number of views")
        seen.yaxis.set_major_formatter(PercentFormatter(1.0))
        for axis in (quality, seen):
            axis.grid(color=theme.faint, lw=0.7)
        moving = [run for run in histories if run.lifetime_counts is not None]
        if moving:
            for run, axis in zip(moving, below.subplots(1, len(moving), sharey=True, squeeze=False)[0]):
                _lifetimes(axis, run)
            below.suptitle(
                "How long they live, √Σtt in frames: histograms as training goes on; line: the median",
                x=0.01,
                ha="left",
                fontsize=10,
            )
        buffer = io.StringIO()
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    return buffer.getvalue()


def _lifetimes(axis: Axes, run: History) -> None:
    """A column an evaluation, each with its largest bin at full ink."""
    ends = run.iteration / run.iteration[-1]
    shades = run.lifetime_counts / run.lifetime_counts.max(axis=1, keepdims=True)
    axis.pcolormesh(np.concatenate([[0.0], ends]), BIN_EDGES, shades.T, cmap="Blues", vmin=0, vmax=1, rasterized=True)
    axis.plot(ends - 0.5 * np.diff(ends, prepend=0.0), run.lifetimes[:, 2], color="#d55e00", lw=1.5)
    axis.set_yscale("log")
    axis.set_title(run.label)
    axis.set_xlabel("part of the schedule")


def mosaic(rows: Sequence[Sequence[np.ndarray]]) -> Image.Image:
    """Images (H, W, 3) float in [0, 1] of one size, side by side, a list a row, white between them."""
    height, width = rows[0][0].shape[:2]
    columns = max(map(len, rows))
    canvas = np.full((len(rows) * (height + _GAP) - _GAP, columns * (width + _GAP) - _GAP, 3), 255, np.uint8)
    for i, row in enumerate(rows):
        for j, image in enumerate(row):
            top, left = i * (height + _GAP), j * (width + _GAP)
            canvas[top : top + height, left : left + width] = np.rint(np.clip(image, 0, 1) * 255)
    return Image.fromarray(canvas)
