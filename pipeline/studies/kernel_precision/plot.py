"""The diagram: error against time, a colour a trade-off, the Pareto front as steps, the default ringed."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence

import matplotlib
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from pipeline.presentation.theme import LIGHT, Theme
from pipeline.studies.kernel_precision.measure import Point
from pipeline.studies.kernel_precision.pareto import on_front
from pipeline.studies.kernel_precision.variants import DEFAULT

_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#b5519b", "#e69f00", "#56b4e9", "#7a7f87", "#882255", "#999933")
_MARKERS = "osD^vPX*<"
_WIDEST = 1.9  # × the default's time: what is slower stands at the edge with its time, or the rest would be a dot
_ROOM = 0.07  # decades of error between two names
_PANELS = (("image_max", "largest error of the image"), ("gradient_rms", "gradients, relative RMS error"))


def draw(points: Sequence[Point], title: str, theme: Theme = LIGHT) -> str:
    """SVG text; the same numbers give the same bytes. Points without a time are not drawn."""
    timed = [p for p in points if p.milliseconds == p.milliseconds]
    trades = list(dict.fromkeys(p.trade for p in timed if p.name != DEFAULT))
    with matplotlib.rc_context({"svg.hashsalt": "work-precision", "font.family": "DejaVu Sans", "font.size": 9.5}):
        figure = Figure(figsize=(12.6, 5.6))
        FigureCanvasSVG(figure)
        figure.patch.set_facecolor("white")
        axes = figure.subplots(
            1, 2, gridspec_kw={"left": 0.06, "right": 0.985, "bottom": 0.11, "top": 0.76, "wspace": 0.16}
        )
        for axis, (name, label) in zip(axes, _PANELS, strict=True):
            default = next(p for p in timed if p.name == DEFAULT)
            edge = _WIDEST * default.milliseconds
            beyond = 0
            for trade, colour, marker in zip(trades, _COLOURS, _MARKERS, strict=False):
                line = [p for p in timed if p.trade == trade]
                ordered = {} if trade in ("culling and masks", "built again") else {"lw": 0.8}
                axis.plot(
                    [min(p.milliseconds, edge) for p in line],
                    [getattr(p.errors, name) for p in line],
                    marker=marker,
                    color=colour,
                    ms=6,
                    label=trade,
                    **{"lw": 0, **ordered},
                )
                for p in line:
                    if p.milliseconds > edge:
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
            at = sorted({(p.milliseconds, getattr(p.errors, name)) for p in timed})
            best = [point for point, on in zip(at, on_front(*zip(*at, strict=True)), strict=True) if on]
            axis.plot(
                *zip(*best, strict=True),
                color=theme.ink,
                lw=1.2,
                drawstyle="steps-post",
                zorder=0,
                label="Pareto front",
            )
            axis.plot(
                default.milliseconds,
                getattr(default.errors, name),
                "o",
                ms=13,
                mfc="none",
                mec=theme.ink,
                mew=1.6,
                label="default",
            )
            named = [getattr(default.errors, name)]  # heights with a name; what is too near to one goes without
            for p in sorted(timed, key=lambda p: p.milliseconds):
                here = p.milliseconds, getattr(p.errors, name)
                if here in best and all(abs(math.log10(here[1] / other)) > _ROOM for other in named):
                    named.append(here[1])
                    axis.annotate(
                        p.name if p.trade == "several at once" else p.label,
                        here,
                        xytext=(-7, -3),
                        textcoords="offset points",
                        ha="right",
                        fontsize=7.5,
                    )
            axis.set(
                yscale="log",
                xlim=(0.7 * at[0][0], 1.04 * edge),
                xlabel="forward and backward, CPU time of one thread, ms",
            )
            axis.set_title(label, loc="left", fontsize=10, color=theme.ink)
            axis.grid(color=theme.faint, lw=0.7, which="both")
            axis.set_axisbelow(True)
        handles, labels = axes[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="upper left", bbox_to_anchor=(0.05, 0.95), ncols=5, frameon=False)
        figure.text(0.06, 0.96, title, fontsize=9, color=theme.ink)
        buffer = io.StringIO()
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    return buffer.getvalue()
