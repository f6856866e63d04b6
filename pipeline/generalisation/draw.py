"""The figures: seen and unseen PSNR and lifetimes as training goes on; one moment from a seen and an unseen place."""

from __future__ import annotations

import io
from collections.abc import Sequence

import matplotlib
import numpy as np
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from PIL import Image

from pipeline.report.plots import LIGHT, Theme

from .history import History

_GAP = 6  # pixels between pictures


def draw(histories: Sequence[History], theme: Theme = LIGHT) -> str:
    """SVG text of runs on one scene, a colour a run; the same numbers give the same bytes."""
    with matplotlib.rc_context({"svg.hashsalt": "generalisation", "font.family": "DejaVu Sans", "font.size": 9.5}):
        figure = Figure(figsize=(11.0, 4.0), facecolor="white")
        FigureCanvasSVG(figure)
        quality, life = figure.subplots(1, 2, gridspec_kw={"left": 0.05, "right": 0.985, "bottom": 0.13, "top": 0.8,
                                                           "wspace": 0.13})
        for run, colour in zip(histories, theme.ablations, strict=False):
            done = run.iteration / run.iteration[-1]
            quality.plot(done, run.train_psnr, "--", color=colour, lw=1.2)
            quality.plot(done, run.psnr, color=colour, lw=1.8, label=run.label)
            if run.lifetimes is not None:
                life.plot(done, run.lifetimes[:, 2], color=colour, lw=1.8)
                life.fill_between(done, run.lifetimes[:, 0], run.lifetimes[:, -1], color=colour, alpha=0.12, lw=0)
        quality.set_title("PSNR, dB: solid held-out views, dashed training views", loc="left", fontsize=10)
        life.set_title("√Σtt in frames: median, and from 5 % to 95 %", loc="left", fontsize=10)
        life.set_yscale("log")
        for axis in (quality, life):
            axis.set_xlabel("part of the schedule")
            axis.grid(color=theme.faint, lw=0.7)
        figure.legend(*quality.get_legend_handles_labels(), loc="upper left", bbox_to_anchor=(0.04, 0.93), ncols=5,
                      frameon=False)
        figure.text(0.05, 0.95, histories[0].scene, fontsize=10, color=theme.ink)
        buffer = io.StringIO()
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    return buffer.getvalue()


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
