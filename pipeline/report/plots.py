"""Training curves, one figure a scene: PSNR against seconds and iterations, Gaussians against seconds.

SVG, in a light and a dark theme; the same numbers give the same bytes, so a committed plot changes only when
they do.
"""

from __future__ import annotations

import io
from dataclasses import dataclass

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullLocator

from . import paper, scenes

_LINES = ("-", "--", ":", "-.")  # by schedule
_GRID = 200  # points of a band
_LOG_RATIO = 4  # a schedule so many times longer than another squeezes it to a wall: logarithmic axis then


@dataclass(frozen=True)
class Theme:
    """Colours on one background; colour-blind readers tell the ablations apart too (after Okabe, Ito)."""

    name: str
    ink: str
    faint: str
    ablations: tuple[str, ...]  # full, no_4drot, no_4dsh, no_time_split, any other


LIGHT = Theme("light", "#1d2430", "#d9dde3", ("#0072b2", "#d55e00", "#009e73", "#b5519b", "#7a7f87"))
DARK = Theme("dark", "#e4e7ec", "#3a414d", ("#5ab6f0", "#f2955c", "#3ccb9e", "#e39bcf", "#a6abb3"))

_PANELS = (
    ("train_seconds", "psnr", "training time, s (evaluation left out)", "PSNR, dB, test views"),
    ("iteration", "psnr", "iteration", "PSNR, dB, test views"),
    ("train_seconds", "n_gaussians", "training time, s (evaluation left out)", "Gaussians"),
)


def curve_scenes(curves: pd.DataFrame) -> list[str]:
    """Scenes with at least one curve, in the report's order."""
    return scenes.in_order(curves["scene"])


def plot_scene(curves: pd.DataFrame, scene: str, theme: Theme = LIGHT) -> str:
    """SVG text: a line for each schedule × ablation, mean over seeds, in a band of ± one std."""
    curves = curves[curves["scene"] == scene]
    names = scenes.ablations_in_order(curves["ablation"])
    trains = sorted(curves["train"].unique())
    with matplotlib.rc_context({"svg.hashsalt": scene, "font.family": "DejaVu Sans", "font.size": 9.5}):
        figure = Figure(figsize=(12.6, 3.9))
        FigureCanvasSVG(figure)
        # Margins by hand: the layout solver's last digits differ from run to run, and with them the SVG.
        axes = figure.subplots(
            1,
            3,
            width_ratios=(1.5, 1.1, 1.1),
            gridspec_kw={"left": 0.035, "right": 0.985, "bottom": 0.13, "top": 0.8, "wspace": 0.16},
        )
        for axis, (x, y, x_label, y_label) in zip(axes, _PANELS):
            for name in names:
                for train in trains:
                    of_line = curves[(curves["ablation"] == name) & (curves["train"] == train)]
                    if len(of_line):
                        label = name if len(trains) == 1 else f"{name}, {train}"
                        colour = theme.ablations[_colour_index(name)]
                        _draw(axis, of_line, x, y, colour, _LINES[trains.index(train) % len(_LINES)], label)
            ends = curves.groupby("run")[x].max()
            _finish(axis, x_label, y_label, theme, log=ends.max() > _LOG_RATIO * ends.min())
        _paper_line(axes[0], scene, theme)
        handles, labels = axes[0].get_legend_handles_labels()
        figure.legend(
            handles,
            labels,
            loc="upper left",
            bbox_to_anchor=(0.027, 1.0),
            ncols=4,
            frameon=False,
            labelcolor=theme.ink,
        )
        buffer = io.StringIO()
        figure.savefig(buffer, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    return buffer.getvalue()


def band(curves: pd.DataFrame, x: str, y: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(x, mean, std) over runs on a grid where every run has values; each run is interpolated linearly.

    Seeds are not evaluated at the same second, so their values can only be compared in between. The std (n -
    1) is zero for a single run.
    """
    runs = [(g[x].to_numpy(float), g[y].to_numpy(float)) for _, g in curves.sort_values(x).groupby("run")]
    low, high = max(xs[0] for xs, _ in runs), min(xs[-1] for xs, _ in runs)
    if len(runs) == 1 or high <= low:
        xs, ys = runs[0]
        return xs, ys, np.zeros_like(ys)
    grid = np.linspace(low, high, _GRID)
    values = np.stack([np.interp(grid, xs, ys) for xs, ys in runs])
    return grid, values.mean(axis=0), values.std(axis=0, ddof=1)


def _draw(axis: Axes, curves: pd.DataFrame, x: str, y: str, colour: str, line: str, label: str) -> None:
    xs, mean, std = band(curves, x, y)
    axis.plot(xs, mean, line, color=colour, linewidth=1.8, label=label)
    if std.any():
        axis.fill_between(xs, mean - std, mean + std, color=colour, alpha=0.18, linewidth=0)
    axis.plot(xs[-1], mean[-1], "o", color=colour, markersize=4)


def _finish(axis: Axes, x_label: str, y_label: str, theme: Theme, log: bool) -> None:
    axis.set_xlabel(x_label, color=theme.ink)
    axis.set_title(y_label, color=theme.ink, loc="left", fontsize=10)
    axis.grid(color=theme.faint, linewidth=0.7)
    axis.set_axisbelow(True)
    axis.tick_params(colors=theme.ink, length=0)
    for side in axis.spines.values():
        side.set_visible(False)
    if log:
        axis.set_xscale("log")
        axis.xaxis.set_major_locator(LogLocator(10, subs=(1, 2, 5)))
        axis.xaxis.set_minor_locator(NullLocator())
    else:
        axis.xaxis.set_major_locator(MaxNLocator(6))
    for one in (axis.xaxis, axis.yaxis):
        one.set_major_formatter(
            FuncFormatter(_in_thousands if one.get_view_interval()[1] >= 5000 else _plain)
        )


def _paper_line(axis: Axes, scene: str, theme: Theme) -> None:
    """The paper's PSNR of this scene, where it gives one (Plenoptic Video only)."""
    if scene in scenes.PLENOPTIC:
        row = next(r for r in paper.read("table1_per_scene") if r["method"].endswith("(this paper)"))
        axis.axhline(
            float(row[scenes.short(scene)]),
            color=theme.ink,
            linewidth=1,
            linestyle=(0, (1, 2)),
            label=f"paper, {row[scenes.short(scene)]} dB",
        )


def _colour_index(ablation: str) -> int:
    known = ("full", "no_4drot", "no_4dsh", "no_time_split")
    return known.index(ablation) if ablation in known else len(known)


def _plain(value: float, _: object) -> str:
    return f"{value:g}"


def _in_thousands(value: float, _: object) -> str:
    return f"{value / 1000:g}k" if value else "0"
