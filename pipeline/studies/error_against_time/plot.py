"""The figure: mean PSNR against CPU seconds on a logarithmic axis, a colour for a recipe, a dash for a kernel."""

from __future__ import annotations

import io
from typing import Any

import matplotlib
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from pipeline.presentation.theme import LIGHT
from pipeline.studies.error_against_time.curves import Curve, mean_until_stopped

_DASHES: tuple[Any, ...] = ("solid", (0, (4, 1.5)), (0, (1, 1.2)))
_MARGINS = {"left": 0.07, "right": 0.985, "bottom": 0.13, "top": 0.88}


def draw(groups: dict[str, list[Curve]]) -> str:
    """SVG text; the same numbers give the same bytes. A dot ends the curve of finished runs."""
    recipes = list(dict.fromkeys(curves[0].recipe for curves in groups.values()))
    kernels = sorted({curves[0].kernel for curves in groups.values()}, reverse=True)
    style: Any = {"svg.hashsalt": "error_against_time", "font.family": "DejaVu Sans", "font.size": 9.5}
    with matplotlib.rc_context(style):
        figure = Figure(figsize=(9, 4.8), facecolor="white")
        FigureCanvasSVG(figure)
        axis = figure.subplots(gridspec_kw=_MARGINS)
        for name, curves in groups.items():
            times, psnr = mean_until_stopped(curves)
            colour = LIGHT.lines[recipes.index(curves[0].recipe) % len(LIGHT.lines)]
            dash = _DASHES[kernels.index(curves[0].kernel) % len(_DASHES)]
            axis.plot(times, psnr, color=colour, linestyle=dash, linewidth=1.6, label=name)
            if all(curve.finished for curve in curves):
                axis.plot(times[-1:], psnr[-1:], "o", color=colour, markersize=4)
        axis.set_xscale("log")
        axis.xaxis.set_major_locator(LogLocator(10, subs=(1, 2, 5)))
        axis.xaxis.set_minor_locator(NullLocator())
        axis.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_xlabel("CPU seconds of training, without evaluation")
        axis.set_ylabel("mean PSNR of the test views, dB")
        axis.grid(color=LIGHT.faint, linewidth=0.7)
        axis.set_axisbelow(True)
        figure.legend(loc="upper left", bbox_to_anchor=(0.06, 1.0), ncols=4, frameon=False)
        buffer = io.StringIO()
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    return buffer.getvalue()
