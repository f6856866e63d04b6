"""The work-precision diagram: error against time, one colour for each trade-off, with the Pareto front."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from matplotlib.axes import Axes

from pipeline.presentation.theme import LIGHT, Theme
from pipeline.studies.kernel_precision.measure import Point
from pipeline.studies.kernel_precision.pareto_front import on_front
from pipeline.studies.kernel_precision.variants import DEFAULT
from pipeline.studies.output import svg_figure, svg_style, svg_text

_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#b5519b", "#e69f00", "#56b4e9", "#7a7f87", "#882255", "#999933")
_MARKERS = "osD^vPX*<"
_MAX_TIME = 1.9  # × the default's time: slower variants are drawn at this edge, labelled with their time
_LABEL_SPACING = 0.07  # decades of error between two labels
_UNORDERED = ("culling and masks", "built again")  # trade-offs without an order: no line between their points
_PANELS = (("image_max", "largest error of the image"), ("gradient_rms", "gradients, relative RMS error"))
_MARGINS = {"left": 0.06, "right": 0.985, "bottom": 0.11, "top": 0.76, "wspace": 0.16}


def draw(points: Sequence[Point], title: str, theme: Theme = LIGHT) -> str:
    """SVG text; the same numbers give the same bytes. Points without a time are not drawn."""
    timed = [p for p in points if p.milliseconds == p.milliseconds]
    with svg_style("kernel_precision"):
        figure = svg_figure(12.6, 5.6)
        axes = figure.subplots(1, 2, gridspec_kw=_MARGINS)
        for axis, (name, label) in zip(axes, _PANELS, strict=True):
            _panel(axis, timed, name, theme)
            axis.set_title(label, loc="left", fontsize=10, color=theme.ink)
        handles, labels = axes[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="upper left", bbox_to_anchor=(0.05, 0.95), ncols=5, frameon=False)
        figure.text(0.06, 0.96, title, fontsize=9, color=theme.ink)
        return svg_text(figure)


def _panel(axis: Axes, timed: Sequence[Point], name: str, theme: Theme) -> None:
    """One error, `name` of Errors, against time."""
    default = next(p for p in timed if p.name == DEFAULT)
    edge = _MAX_TIME * default.milliseconds
    _trade_offs(axis, timed, name, edge)
    points = sorted({(p.milliseconds, getattr(p.errors, name)) for p in timed})
    front = [point for point, on in zip(points, on_front(*zip(*points, strict=True)), strict=True) if on]
    times, errors = zip(*front, strict=True)
    axis.plot(times, errors, color=theme.ink, lw=1.2, drawstyle="steps-post", zorder=0, label="Pareto front")
    ring: dict[str, Any] = {"ms": 13, "mfc": "none", "mec": theme.ink, "mew": 1.6}
    axis.plot(default.milliseconds, getattr(default.errors, name), "o", **ring, label="default")
    _front_labels(axis, timed, name, set(front), getattr(default.errors, name))
    axis.set(
        yscale="log", xlim=(0.7 * points[0][0], 1.04 * edge), xlabel="forward and backward, CPU time of one thread, ms"
    )
    axis.grid(color=theme.faint, lw=0.7, which="both")
    axis.set_axisbelow(True)


def _trade_offs(axis: Axes, timed: Sequence[Point], name: str, edge: float) -> None:
    """The points of each trade-off; those slower than `edge` (ms) are drawn there with an arrow."""
    beyond = 0
    trades = dict.fromkeys(p.trade for p in timed if p.name != DEFAULT)
    for trade, colour, marker in zip(trades, _COLOURS, _MARKERS, strict=False):
        line = [p for p in timed if p.trade == trade]
        times, errors = [min(p.milliseconds, edge) for p in line], [getattr(p.errors, name) for p in line]
        width = 0 if trade in _UNORDERED else 0.8
        axis.plot(times, errors, marker=marker, color=colour, ms=6, label=trade, lw=width)
        for p in (p for p in line if p.milliseconds > edge):
            beyond += 1
            axis.annotate(
                f"{p.label}: {p.milliseconds:.0f} ms →",
                (edge, getattr(p.errors, name)),
                xytext=(0, 11 * beyond),
                textcoords="offset points",
                ha="right",
                fontsize=7.5,
                color=colour,
            )


def _front_labels(
    axis: Axes, timed: Sequence[Point], name: str, front: set[tuple[float, float]], default_error: float
) -> None:
    """Names the points of the front, except where another label is too close."""
    labelled = [default_error]
    for p in sorted(timed, key=lambda p: p.milliseconds):
        point = p.milliseconds, getattr(p.errors, name)
        if point in front and all(abs(math.log10(point[1] / other)) > _LABEL_SPACING for other in labelled):
            labelled.append(point[1])
            axis.annotate(
                p.name if p.trade == "several at once" else p.label,
                point,
                xytext=(-7, -3),
                textcoords="offset points",
                ha="right",
                fontsize=7.5,
            )
