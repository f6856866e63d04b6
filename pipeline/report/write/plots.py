"""Training curves, one figure a comparison: quality and number of Gaussians against seconds and against iterations.

SVG, in a light and a dark theme; the same numbers give the same bytes, so a committed plot changes only when
they do.
"""

from __future__ import annotations

import io
import math

import matplotlib
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullLocator

from pipeline.presentation.theme import LIGHT, Theme
from pipeline.report.compare.bands import band, end_of_coarse, split_at
from pipeline.report.compare.comparisons import Comparison, Line
from pipeline.report.read import paper, scenes
from pipeline.runs.read.collect import Collection
from pipeline.runs.read.model_labels import ablation_of

_LOG_RATIO = 4  # a schedule so many times longer than another squeezes it to a wall: logarithmic axis then


_ROWS = (("train_seconds", "training time, s (evaluation left out)"), ("iteration", "iteration"))
_COLUMNS = (
    ("psnr", "PSNR, dB, test views"),
    ("ssim", "SSIM, test views"),
    ("test_loss", "loss, test views"),
    ("n_gaussians", "Gaussians"),
)
_CAPTION = (
    "Line: mean over seeds, each interpolated linearly, where all of them have values; dot: its end. "
    "Band: ± one standard deviation over seeds."
)
_COARSE = (
    "Dashed: trained at a coarse resolution but evaluated at the full one, where such a model reads low; "
    "compare lines where they are solid."
)
_ABOVE, _LEGEND_ROW, _ROW_HEIGHT, _BELOW = 0.42, 0.21, 2.1, 0.85  # inches
_LEGEND_COLUMNS = 4


def plot(collection: Collection, comparison: Comparison, theme: Theme = LIGHT) -> str:
    """SVG text: a column a quantity, those that no run has left out; against seconds, and below against iterations."""
    curves = collection.curves[collection.curves["scene"] == comparison.scene]
    runs_of = {
        line: curves[(curves["ablation"] == line.ablation) & (curves["train"] == line.train)]
        for line in comparison.lines
    }
    shown = pd.concat(runs_of.values())
    columns = [(y, label) for y, label in _COLUMNS if shown[y].notna().any()]
    colours = _colours(comparison.lines, theme.ablations)
    # Text as text: as outlines it would be half of the page.
    with matplotlib.rc_context(
        {
            "svg.hashsalt": comparison.slug,
            "svg.fonttype": "none",
            "font.family": ["DejaVu Sans", "sans-serif"],
            "font.size": 9.5,
        }
    ):
        entries = len(runs_of) + (comparison.scene in scenes.PLENOPTIC)  # the paper's line
        above = _ABOVE + _LEGEND_ROW * math.ceil(entries / _LEGEND_COLUMNS)
        height = above + _ROW_HEIGHT * len(_ROWS) + _BELOW
        figure = Figure(figsize=(12.6, height))
        FigureCanvasSVG(figure)
        # Margins by hand: the layout solver's last digits differ from run to run, and with them the SVG.
        margins = {
            "left": 0.035,
            "right": 0.985,
            "bottom": _BELOW / height,
            "top": 1 - above / height,
            "wspace": 0.17,
            "hspace": 0.34,
        }
        axes = figure.subplots(len(_ROWS), len(columns), sharey="col", sharex="row", squeeze=False, gridspec_kw=margins)
        any_coarse = False
        for row, (x, x_label) in enumerate(_ROWS):
            coarse = {line: end_of_coarse(runs, collection.settings, x) for line, runs in runs_of.items()}
            any_coarse |= any(coarse.values())
            for axis, (y, label) in zip(axes[row], columns):
                for line, runs in runs_of.items():
                    if runs[y].notna().all():
                        _draw(axis, runs, x, y, colours[line], line.label, coarse[line])
                ends = shown.groupby("run")[x].max()
                _finish(axis, label if row == 0 else "", theme, log=ends.max() > _LOG_RATIO * ends.min())
            axes[row, 0].set_xlabel(x_label, color=theme.ink, loc="left")
        _paper_line(axes[0, 0], comparison.scene, theme)
        handles, labels = axes[0, 0].get_legend_handles_labels()
        figure.legend(
            handles,
            labels,
            loc="upper left",
            bbox_to_anchor=(0.027, 1.0),
            ncols=_LEGEND_COLUMNS,
            frameon=False,
            labelcolor=theme.ink,
        )
        caption = f"{_CAPTION}\n{_COARSE}" if any_coarse else _CAPTION
        figure.text(0.035, 0.06 / height, caption, color=theme.ink, fontsize=8.5, va="bottom", linespacing=1.4)
        buffer = io.StringIO()
        figure.savefig(buffer, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    return buffer.getvalue()


def _draw(axis: Axes, curves: pd.DataFrame, x: str, y: str, colour: str, label: str, coarse: float) -> None:
    xs, mean, std = band(curves, x, y)
    before, after = split_at(xs, mean, coarse)
    axis.plot(*before, linestyle=(0, (3, 1.5)), color=colour, linewidth=1.4)
    axis.plot(*after, color=colour, linewidth=1.8, label=label)
    if std.any():
        axis.fill_between(xs, mean - std, mean + std, color=colour, alpha=0.18, linewidth=0)
    axis.plot(xs[-1], mean[-1], "o", color=colour, markersize=4)


def _finish(axis: Axes, title: str, theme: Theme, log: bool) -> None:
    axis.set_title(title, color=theme.ink, loc="left", fontsize=10)
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
        axis.xaxis.set_major_locator(MaxNLocator(5))
    for one in (axis.xaxis, axis.yaxis):
        one.set_major_formatter(FuncFormatter(_in_thousands if one.get_view_interval()[1] >= 5000 else _plain))


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


def _colours(lines: tuple[Line, ...], colours: tuple[str, ...]) -> dict[Line, str]:
    """An ablation has the same colour in every figure, as long as it is there once; other lines by their place."""
    known = ("full", "no_4drot", "no_4dsh", "no_time_split")
    found: dict[Line, str] = {}
    for place, line in enumerate(lines):
        ablation = ablation_of(line.ablation)
        if line.label != line.ablation:
            found[line] = colours[place % len(colours)]
        elif ablation in known and colours[known.index(ablation)] not in found.values():
            found[line] = colours[known.index(ablation)]
        else:
            found[line] = colours[-1]
    return found


def _plain(value: float, _: object) -> str:
    return f"{value:g}"


def _in_thousands(value: float, _: object) -> str:
    return f"{value / 1000:g}k" if value else "0"
