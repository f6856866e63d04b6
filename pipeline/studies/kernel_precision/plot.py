"""The work-precision diagram: error against time, one colour for each trade-off, with the Pareto front."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from pipeline.presentation.theme import LIGHT
from pipeline.studies.kernel_precision.measure import Point
from pipeline.studies.kernel_precision.table import on_front
from pipeline.studies.kernel_precision.variants import DEFAULT

_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#b5519b", "#e69f00", "#56b4e9", "#7a7f87", "#882255", "#999933")
_MARKERS = "osD^vPX*<"
_MAX_TIME = 1.9  # × the default's time: slower variants are drawn at this edge, labelled with their time
_LABEL_SPACING = 0.07  # decades of error between two labels
_UNORDERED = ("culling and masks", "built again")  # trade-offs without an order: no line between their points
_PANELS = (("image_max", "largest error of the image"), ("gradient_rms", "gradients, relative RMS error"))
_MARGINS = {"left": 0.06, "right": 0.985, "bottom": 0.11, "top": 0.76, "wspace": 0.16}


def draw(points: Sequence[Point], title: str) -> str:
    """SVG text; the same numbers give the same bytes. Points without a time are not drawn."""
    timed = [p for p in points if p.milliseconds == p.milliseconds]
    style: Any = {"svg.hashsalt": "kernel_precision", "font.family": "DejaVu Sans", "font.size": 9.5}
    with matplotlib.rc_context(style):
        figure = Figure(figsize=(12.6, 5.6), facecolor="white")
        FigureCanvasSVG(figure)
        axes = figure.subplots(1, 2, gridspec_kw=_MARGINS)
        for axis, (name, label) in zip(axes, _PANELS, strict=True):
            _panel(axis, timed, name)
            axis.set_title(label, loc="left", fontsize=10)
        handles, labels = axes[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="upper left", bbox_to_anchor=(0.05, 0.95), ncols=5, frameon=False)
        figure.text(0.06, 0.95, title, fontsize=9)
        buffer = io.StringIO()
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
        return buffer.getvalue()


def _panel(axis: Axes, timed: Sequence[Point], name: str) -> None:
    """One error, `name` of Errors, against time. Variants slower than the edge are drawn there with an arrow."""
    default = next(p for p in timed if p.name == DEFAULT)
    edge, beyond = _MAX_TIME * default.milliseconds, 0
    trades = dict.fromkeys(p.trade for p in timed if p.name != DEFAULT)
    small: dict[str, Any] = {"textcoords": "offset points", "ha": "right", "fontsize": 7.5}
    for trade, colour, marker in zip(trades, _COLOURS, _MARKERS, strict=False):
        line = [(p, min(p.milliseconds, edge), getattr(p.errors, name)) for p in timed if p.trade == trade]
        times, errors = [time for _, time, _ in line], [error for *_, error in line]
        axis.plot(times, errors, marker + "-", color=colour, ms=6, label=trade, lw=0 if trade in _UNORDERED else 0.8)
        for p, time, error in line:
            if p.milliseconds > edge:
                beyond += 1
                text = f"{p.label}: {p.milliseconds:.0f} ms →"
                axis.annotate(text, (time, error), xytext=(0, 11 * beyond), color=colour, **small)
    points = sorted((p.milliseconds, getattr(p.errors, name), p.label) for p in timed)
    on = on_front([time for time, *_ in points], [error for _, error, _ in points])
    front = {(time, error): label for (time, error, label), is_on in zip(points, on, strict=True) if is_on}
    axis.plot(
        *zip(*front, strict=True), color=LIGHT.ink, lw=1.2, drawstyle="steps-post", zorder=0, label="Pareto front"
    )
    at = default.milliseconds, getattr(default.errors, name)
    labelled = [at[1]]
    for point, label in front.items():
        if all(abs(math.log10(point[1] / other)) > _LABEL_SPACING for other in labelled):
            labelled.append(point[1])
            axis.annotate(label, point, xytext=(-7, -3), **small)
    axis.plot(*at, "o", ms=13, mfc="none", mec=LIGHT.ink, mew=1.6, label="default")
    label = "forward and backward, CPU time of one thread, ms"
    axis.set(yscale="log", xlim=(0.7 * points[0][0], 1.04 * edge), xlabel=label)
    axis.grid(color=LIGHT.faint, lw=0.7, which="both")
    axis.set_axisbelow(True)
