"""One self-contained HTML page: page.html filled in, every image inline, no script, nothing fetched."""

from __future__ import annotations

import base64
import re
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from pipeline.presentation.layout import laid_out
from pipeline.report.write.content import Content
from pipeline.report.write.strips import DIFFERENCE_GAIN

# What is shown at once; the rest is there to be unfolded.
_FEW_STRIPS = 8  # up to so many all are shown, else of each scene and schedule those of the full model
_CARDS, _GROUPS, _PLOTS, _ROWS = 16, 6, 6, 24


def render_page(content: Content) -> str:
    """HTML text. Text is escaped by the template engine; images become data URIs. No section is empty."""
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {
        "svg_uri": lambda svg: _data_uri("image/svg+xml", svg.encode()),
        "webp_uri": lambda webp: _data_uri("image/webp", webp),
        "pieces": pieces,
    }
    return environment.get_template("page.html").render(
        content=content,
        summary=content.summary,
        laid_out=laid_out,
        all_strips=len(content.strips) <= _FEW_STRIPS,
        shown_cards=_CARDS,
        shown_groups=_GROUPS,
        shown_plots=_PLOTS,
        shown_rows=_ROWS,
        difference_gain=DIFFERENCE_GAIN,
        sections=_sections(content),
    )


def _sections(content: Content) -> dict[str, str]:
    """id -> title of the sections that hold something, in reading order."""
    found = {
        "summary": ("Summary", True),
        "strips": ("Pictures", content.strips),
        "curves": ("Training curves", content.plots),
        "ablations": ("Ablations", content.ablations),
        "paper": ("The paper’s tables, ours beside", content.paper),
        "scenes": ("Scene by scene", content.scenes),
        "comparisons": ("Schedules and batches", content.comparisons),
        "sfm": ("Structure from motion", content.structure),
        "raw": ("Raw numbers", content.raw),
    }
    return {key: title for key, (title, there) in found.items() if there}


def pieces(text: str) -> list[str]:
    """Text cut where it may be broken: after the / _ and = that names are put together with."""
    return re.split(r"(?<=[/_=])", text)


def _data_uri(mime: str, content: bytes) -> str:
    return f"data:{mime};base64,{base64.b64encode(content).decode()}"
