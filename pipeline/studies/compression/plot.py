"""The plot: PSNR against megabytes and against frames a second, one line for each precision."""

from __future__ import annotations

from collections.abc import Sequence

from pipeline.presentation.theme import LIGHT, Theme
from pipeline.studies.compression.measure import Point
from pipeline.studies.output import svg_figure, svg_style, svg_text

_PANELS = (("megabytes", "MB on disk"), ("fps", "frames a second"))
_MARGINS = {"left": 0.07, "right": 0.985, "bottom": 0.14, "top": 0.86, "wspace": 0.08}


def draw(points: Sequence[Point], title: str, theme: Theme = LIGHT) -> str:
    """SVG text; the same numbers give the same bytes."""
    with svg_style("compression"):
        figure = svg_figure(9.6, 3.6)
        panels = figure.subplots(1, 2, sharey=True, gridspec_kw=_MARGINS)
        for axis, (name, label) in zip(panels, _PANELS, strict=True):
            for precision, colour in zip(dict.fromkeys(p.precision for p in points), theme.ablations):
                line = [p for p in points if p.precision == precision]
                axis.plot(
                    [getattr(p, name) for p in line], [p.psnr for p in line], "o-", ms=4, color=colour, label=precision
                )
            for p in (p for p in points if p.precision == points[-1].precision):
                axis.annotate(
                    f"{p.fraction:.0%}",
                    (getattr(p, name), p.psnr),
                    xytext=(3, -9),
                    textcoords="offset points",
                    fontsize=7,
                    color=theme.ink,
                )
            axis.set(xlabel=label)
            axis.grid(color=theme.faint, lw=0.7)
        panels[0].set_ylabel("PSNR, dB, test views")
        panels[0].legend(frameon=False)
        figure.text(0.07, 0.93, title, fontsize=9, color=theme.ink)
        return svg_text(figure)
