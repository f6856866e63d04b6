"""Plots learning curves as SVG: quality and number of Gaussians over training time and over iterations.

The plots are deterministic: equal numbers give equal bytes.
"""

from __future__ import annotations

import io
import math
from collections.abc import Mapping
from typing import Any

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullLocator

from pipeline.presentation.statistics import MIN_SEEDS, interval_scale
from pipeline.presentation.theme import LIGHT, Theme
from pipeline.report import paper_table, scenes
from pipeline.report.curve_figures import CurveFigure, Line
from pipeline.report.runs import Collection, is_number

_LOG_RATIO = 4  # of the longest to the shortest run; from this ratio the x axis is logarithmic
_ROWS = (
    ("cpu_seconds", "CPU seconds of training (without evaluation)"),
    ("train_seconds", "training time, s (without evaluation)"),
    ("iteration", "iteration"),
)
_COLUMNS = (
    ("psnr", "PSNR, dB, test views"),
    ("psnr_moving", "PSNR, dynamic region, dB"),
    ("ssim", "SSIM, test views"),
    ("test_loss", "loss, test views"),
    ("n_gaussians", "Gaussians"),
)
_CAPTION = (
    "Line: mean over seeds, interpolated linearly, where all seeds have values; dot: its end. "
    f"Band: the 95 % t-interval of the mean, of {MIN_SEEDS} seeds and more."
)
_COARSE = (
    "Dashed: trained at a coarse resolution, evaluated at full resolution, so PSNR is low. "
    "Compare lines where they are solid."
)
_ABOVE, _LEGEND_ROW, _ROW_HEIGHT, _BELOW = 0.42, 0.21, 2.1, 0.85  # inches
_LEGEND_COLUMNS = 4


def plot(collection: Collection, figure_of: CurveFigure) -> str:
    """SVG text in LIGHT: one column per measured quantity; over CPU seconds, or training time where a run did not
    record them (top), and over iterations (bottom), which means over scenes do not have."""
    curves = collection.curves[collection.curves["scene_label"] == figure_of.scene_label]
    runs_of = {
        line: curves[(curves["model"] == line.model) & (curves["recipe_label"] == line.recipe_label)]
        for line in figure_of.lines
    }
    shown = pd.concat(runs_of.values())
    columns = [(y, label) for y, label in _COLUMNS if shown[y].notna().any()]
    recorded = [(x, label) for x, label in _ROWS if shown[x].notna().all()]
    rows = [recorded[0], *(row for row in recorded[1:] if row[0] == "iteration")]
    colours = _colours(figure_of.lines, LIGHT.lines)
    # Text as text elements: outlines would double the size of the page.
    style: Any = {
        "svg.hashsalt": figure_of.slug,
        "svg.fonttype": "none",
        "font.family": ["DejaVu Sans", "sans-serif"],
        "font.size": 9.5,
    }
    with matplotlib.rc_context(style):
        figure, axes = _empty_figure(
            (len(rows), len(columns)), len(runs_of) + (figure_of.scene_label in scenes.PLENOPTIC)
        )
        any_coarse = False
        for row, (x, x_label) in enumerate(rows):
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
    for before, after in zip(*((t.ink, t.faint, *t.lines) for t in (LIGHT, theme))):
        svg = svg.replace(before, after)
    return svg


def _empty_figure(shape: tuple[int, int], legend_entries: int) -> tuple[Figure, np.ndarray]:
    """A figure and its axes, `shape` rows × columns, with space for the legend above and the caption below."""
    above = _ABOVE + _LEGEND_ROW * math.ceil(legend_entries / _LEGEND_COLUMNS)
    height = above + _ROW_HEIGHT * shape[0] + _BELOW
    figure = Figure(figsize=(12.6, height))
    FigureCanvasSVG(figure)
    # Fixed margins: the layout solver is not deterministic in the last digits.
    vertical = {"bottom": _BELOW / height, "top": 1 - above / height, "hspace": 0.34}
    margins = {"left": 0.035, "right": 0.985, "wspace": 0.17} | vertical
    axes = figure.subplots(*shape, sharey="col", sharex="row", squeeze=False, gridspec_kw=margins)
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
    xs, mean, half = mean_and_interval(curves, x, y)
    before, after = split_at(xs, mean, coarse)
    axis.plot(*before, linestyle=(0, (3, 1.5)), color=colour, linewidth=1.4)
    axis.plot(*after, color=colour, linewidth=1.8, label=label)
    if curves["run"].nunique() >= MIN_SEEDS:
        axis.fill_between(xs, mean - half, mean + half, color=colour, alpha=0.18, linewidth=0)
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


# ---- Curves over seeds ----


def mean_and_interval(curves: pd.DataFrame, x: str, y: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(x, mean, half the t-interval) over the runs of `curves`, in the range of `x` that all runs cover.

    Seeds are not evaluated at the same second, so each run is interpolated linearly, at every x at which any run was
    evaluated. A single run has an interval of zero.
    """
    runs = [(g[x].to_numpy(float), g[y].to_numpy(float)) for _, g in curves.sort_values(x).groupby("run")]
    low, high = max(xs[0] for xs, _ in runs), min(xs[-1] for xs, _ in runs)
    if len(runs) == 1 or high <= low:
        xs, ys = runs[0]
        return xs, ys, np.zeros_like(ys)
    grid = np.unique(np.concatenate([xs for xs, _ in runs]))
    grid = grid[(grid >= low) & (grid <= high)]
    values = np.stack([np.interp(grid, xs, ys) for xs, ys in runs])
    return grid, values.mean(axis=0), interval_scale(len(runs)) * values.std(axis=0, ddof=1)


def end_of_coarse(curves: pd.DataFrame, settings: Mapping[str, Mapping[str, Any]], x: str) -> float:
    """The x (train_seconds or iteration) at which full-resolution training begins, mean over runs; 0: at the start.

    settings: run -> its settings. A time budget advances the schedule as in pipeline/training/schedule.py.
    """
    return float(np.mean([_end_of_coarse(curve, settings[run], x) for run, curve in curves.groupby("run")]))


def _end_of_coarse(curve: pd.DataFrame, settings: Mapping[str, Any], x: str) -> float:
    steps = settings.get("train.resolution_steps")
    steps = [step for step in steps if isinstance(step, dict)] if isinstance(steps, list) else []
    untils = [_positive(step.get("until")) for step in steps]
    until, iterations = max(untils, default=0.0), _positive(settings.get("train.iterations"))
    if not until or not iterations:
        return 0.0
    curve = curve.sort_values("iteration")
    progress = curve["iteration"] / iterations
    if budget := _positive(settings.get("train.time_budget_s")):
        progress = np.maximum(progress, curve["train_seconds"] / budget)
    return float(np.interp(until, [0.0, *progress], [0.0, *curve[x]]))


def _positive(value: Any) -> float:
    """`value` if it is a positive finite number, else 0: config.yaml may have been edited by hand."""
    return float(value) if is_number(value) and value > 0 else 0.0


def split_at(xs: np.ndarray, ys: np.ndarray, at: float) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
    """The parts of a curve before and after x = `at`, each (xs, ys) with the point at `at`; one may be empty."""
    if at <= xs[0]:
        return (xs[:0], ys[:0]), (xs, ys)
    if at >= xs[-1]:
        return (xs, ys), (xs[:0], ys[:0])
    y_at, before, after = np.interp(at, xs, ys), xs < at, xs > at
    return (
        (np.append(xs[before], at), np.append(ys[before], y_at)),
        (np.insert(xs[after], 0, at), np.insert(ys[after], 0, y_at)),
    )
