"""The diagram: error against time, a colour a trade-off, the Pareto front as steps, the defaults ringed."""

from __future__ import annotations

import io
from collections.abc import Sequence

import matplotlib
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from pipeline.report.plots import LIGHT, Theme

from .measure import Point
from .pareto import on_front
from .variants import DEFAULT

_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#b5519b", "#e69f00", "#56b4e9", "#7a7f87")  # after Okabe, Ito
_MARKERS = "osD^vPX"
_PANELS = (("image_max", "largest error of the image"), ("gradient_rms", "gradients, relative RMS error"))


def draw(points: Sequence[Point], title: str, theme: Theme = LIGHT) -> str:
    """SVG text; the same numbers give the same bytes. Points without a time are not drawn."""
    timed = [p for p in points if p.milliseconds == p.milliseconds]
    trades = list(dict.fromkeys(p.trade for p in timed if p.name != DEFAULT))
    with matplotlib.rc_context({"svg.hashsalt": "work-precision", "font.family": "DejaVu Sans", "font.size": 9.5}):
        figure = Figure(figsize=(12.6, 5.2))
        FigureCanvasSVG(figure)
        figure.patch.set_facecolor("white")
        axes = figure.subplots(
            1, 2, gridspec_kw={"left": 0.06, "right": 0.985, "bottom": 0.11, "top": 0.78, "wspace": 0.16})
        for axis, (name, label) in zip(axes, _PANELS, strict=True):
            for trade, colour, marker in zip(trades, _COLOURS, _MARKERS, strict=False):
                line = [p for p in timed if p.trade == trade]
                axis.plot([p.milliseconds for p in line], [getattr(p.errors, name) for p in line], marker, color=colour,
                          ms=6, label=trade)
                for p in line:
                    if p.name != DEFAULT:
                        axis.annotate(p.label.split(",")[0] if trade != "several at once" else p.name,
                                      (p.milliseconds, getattr(p.errors, name)), xytext=(4, 4), fontsize=6.5,
                                      textcoords="offset points", color=colour)
            at = sorted({(p.milliseconds, getattr(p.errors, name)) for p in timed})
            best = [point for point, on in zip(at, on_front(*zip(*at, strict=True)), strict=True) if on]
            axis.plot(*zip(*best, strict=True), color=theme.ink, lw=1, drawstyle="steps-post", zorder=0,
                      label="Pareto front")
            default = next(p for p in timed if p.name == DEFAULT)
            axis.plot(default.milliseconds, getattr(default.errors, name), "o", ms=13, mfc="none", mec=theme.ink,
                      mew=1.6, label="default")
            axis.set(xscale="log", yscale="log", xlabel="forward and backward, CPU time of one thread, ms")
            axis.xaxis.set_major_formatter("{x:g}")
            axis.xaxis.set_minor_formatter("{x:g}")
            axis.set_title(label, loc="left", fontsize=10, color=theme.ink)
            axis.grid(color=theme.faint, lw=0.7, which="both")
            axis.set_axisbelow(True)
        handles, labels = axes[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="upper left", bbox_to_anchor=(0.05, 0.95), ncols=5, frameon=False)
        figure.text(0.06, 0.96, title, fontsize=9, color=theme.ink)
        buffer = io.StringIO()
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    return buffer.getvalue()
