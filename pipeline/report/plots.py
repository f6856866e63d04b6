"""Plots learning curves as SVG: quality and number of Gaussians over training time and over iterations.

The plots are deterministic: equal numbers give equal bytes.
"""

from __future__ import annotations

import io
import math
from typing import Any

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullLocator

from pipeline.presentation.theme import LIGHT, Theme
from pipeline.report import paper_table, scenes
from pipeline.report.curve_figures import CurveFigure, Line
from pipeline.report.curve_statistics import end_of_coarse, mean_and_std, split_at
from pipeline.report.runs import Collection

_LOG_RATIO = 4  # of the longest to the shortest run; from this ratio the x axis is logarithmic
_ROWS = (("train_seconds", "training time, s (without evaluation)"), ("iteration", "iteration"))
_COLUMNS = (
    ("psnr", "PSNR, dB, test views"),
    ("psnr_moving", "PSNR, dynamic region, dB"),
    ("ssim", "SSIM, test views"),
    ("test_loss", "loss, test views"),
    ("n_gaussians", "Gaussians"),
)
_CAPTION = (
    "Line: mean over seeds, interpolated linearly, where all seeds have values; dot: its end. "
    "Band: ± one standard deviation over seeds."
)
_COARSE = (
    "Dashed: trained at a coarse resolution, evaluated at full resolution, so PSNR is low. "
    "Compare lines where they are solid."
)
_ABOVE, _LEGEND_ROW, _ROW_HEIGHT, _BELOW = 0.42, 0.21, 2.1, 0.85  # inches
_LEGEND_COLUMNS = 4


def plot(collection: Collection, figure_of: CurveFigure) -> str:
    """SVG text in LIGHT: one column per measured quantity; over training time (top) and over iterations (bottom)."""
    curves = collection.curves[collection.curves["scene_label"] == figure_of.scene_label]
    runs_of = {
        line: curves[(curves["model"] == line.model) & (curves["recipe_label"] == line.recipe_label)]
        for line in figure_of.lines
    }
    shown = pd.concat(runs_of.values())
    columns = [(y, label) for y, label in _COLUMNS if shown[y].notna().any()]
    colours = _colours(figure_of.lines, LIGHT.ablations)
    # Text as text elements: outlines would double the size of the page.
    style: Any = {
        "svg.hashsalt": figure_of.slug,
        "svg.fonttype": "none",
        "font.family": ["DejaVu Sans", "sans-serif"],
        "font.size": 9.5,
    }
    with matplotlib.rc_context(style):
        figure, axes = _empty_figure(len(columns), len(runs_of) + (figure_of.scene_label in scenes.PLENOPTIC))
        any_coarse = False
        for row, (x, x_label) in enumerate(_ROWS):
            coarse = {line: end_of_coarse(runs, collection.settings, x) for line, runs in runs_of.items()}
            any_coarse |= any(coarse.values())
            for axis, (y, label) in zip(axes[row], columns):
                for line, runs in runs_of.items():
                    if runs[y].notna().all():
                        _draw(axis, runs, x, y, colours[line], line.label, coarse[line])
                ends = shown.groupby("run")[x].max()
                _finish(axis, label if row == 0 else "", log=ends.max() > _LOG_RATIO * ends.min())
            axes[row, 0].set_xlabel(x_label, color=LIGHT.ink, loc="left")
        _paper_line(axes[0, 0], figure_of.scene_label)
        _add_legend(figure, axes[0, 0], f"{_CAPTION}\n{_COARSE}" if any_coarse else _CAPTION)
        buffer = io.StringIO()
        figure.savefig(buffer, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    return buffer.getvalue()


def recoloured(svg: str, theme: Theme) -> str:
    """A plot of `plot` in the colours of `theme`."""
    for before, after in zip(*((t.ink, t.faint, *t.ablations) for t in (LIGHT, theme))):
        svg = svg.replace(before, after)
    return svg


def _empty_figure(columns: int, legend_entries: int) -> tuple[Figure, np.ndarray]:
    """A figure and its axes, rows × columns, with space for the legend above and the caption below."""
    above = _ABOVE + _LEGEND_ROW * math.ceil(legend_entries / _LEGEND_COLUMNS)
    height = above + _ROW_HEIGHT * len(_ROWS) + _BELOW
    figure = Figure(figsize=(12.6, height))
    FigureCanvasSVG(figure)
    # Fixed margins: the layout solver is not deterministic in the last digits.
    vertical = {"bottom": _BELOW / height, "top": 1 - above / height, "hspace": 0.34}
    margins = {"left": 0.035, "right": 0.985, "wspace": 0.17} | vertical
    axes = figure.subplots(len(_ROWS), columns, sharey="col", sharex="row", squeeze=False, gridspec_kw=margins)
    return figure, axes


def _add_legend(figure: Figure, axis: Axes, caption: str) -> None:
    """The legend of `axis` above the axes, the caption below them."""
    figure.legend(
        *axis.get_legend_handles_labels(),
        loc="upper left",
        bbox_to_anchor=(0.027, 1.0),
        ncols=_LEGEND_COLUMNS,
        frameon=False,
        labelcolor=LIGHT.ink,
    )
    y = 0.06 / figure.get_figheight()
    figure.text(0.035, y, caption, color=LIGHT.ink, fontsize=8.5, va="bottom", linespacing=1.4)


def _draw(axis: Axes, curves: pd.DataFrame, x: str, y: str, colour: str, label: str, coarse: float) -> None:
    xs, mean, std = mean_and_std(curves, x, y)
    before, after = split_at(xs, mean, coarse)
    axis.plot(*before, linestyle=(0, (3, 1.5)), color=colour, linewidth=1.4)
    axis.plot(*after, color=colour, linewidth=1.8, label=label)
    if std.any():
        axis.fill_between(xs, mean - std, mean + std, color=colour, alpha=0.18, linewidth=0)
    axis.plot(xs[-1], mean[-1], "o", color=colour, markersize=4)


def _finish(axis: Axes, title: str, log: bool) -> None:
    axis.set_title(title, color=LIGHT.ink, loc="left", fontsize=10)
    axis.grid(color=LIGHT.faint, linewidth=0.7)
    axis.set_axisbelow(True)
    axis.tick_params(colors=LIGHT.ink, length=0)
    for side in axis.spines.values():
        side.set_visible(False)
    if log:
        axis.set_xscale("log")
        axis.xaxis.set_major_locator(LogLocator(10, subs=(1, 2, 5)))
        axis.xaxis.set_minor_locator(NullLocator())
    else:
        axis.xaxis.set_major_locator(MaxNLocator(5))
    for one in (axis.xaxis, axis.yaxis):
        one.set_major_formatter(FuncFormatter(_in_thousands if one.get_view_interval()[1] >= 5000 else _plain))


def _paper_line(axis: Axes, scene: str) -> None:
    """A line at the paper's PSNR of this scene (Plenoptic Video only)."""
    if scene in scenes.PLENOPTIC:
        row = next(r for r in paper_table.read("table1_per_scene") if r["method"] == paper_table.THIS_PAPER)
        axis.axhline(
            float(row[scenes.short(scene)]),
            color=LIGHT.ink,
            linewidth=1,
            linestyle=(0, (1, 2)),
            label=f"paper, {row[scenes.short(scene)]} dB",
        )


def _colours(lines: tuple[Line, ...], colours: tuple[str, ...]) -> dict[Line, str]:
    """A colour per line. A model has the same colour in every figure of models; other lines are coloured in order."""
    known = dict(zip(("full", "no_4drot", "no_4dsh", "no_time_split"), colours))
    return {
        line: known.get(line.model, colours[-1]) if line.label == line.model else colours[place % len(colours)]
        for place, line in enumerate(lines)
    }


def _plain(value: float, _: object) -> str:
    return f"{value:g}"


def _in_thousands(value: float, _: object) -> str:
    return f"{value / 1000:g}k" if value else "0"
