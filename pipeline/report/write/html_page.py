"""Renders report.html from html_page.html: one self-contained page with inline images and without scripts."""

from __future__ import annotations

import base64
import os
import re
from functools import partial
from pathlib import Path
from urllib.parse import quote

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from pipeline.presentation.table_layout import laid_out
from pipeline.report.write.image_strips import Strip
from pipeline.report.write.sections import TITLES, Content

# Visible items of each kind; more are in an element that can be expanded.
_CARDS, _SCENES, _PLOTS, _ROWS = 16, 6, 6, 24


def render_page(content: Content, out: Path = Path()) -> str:
    """HTML text. The template engine escapes text; images become data URIs. Empty sections are left out.

    out: the page's folder, from which links lead to the runs' viewers.
    """
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"svg_uri": _svg_uri, "webp_uri": _webp_uri, "pieces": pieces}
    environment.filters["viewer_link"] = partial(viewer_link, out=out)
    return environment.get_template("html_page.html").render(
        content=content,
        summary=content.summary,
        laid_out=laid_out,
        shown_cards=_CARDS,
        shown_scenes=_SCENES,
        shown_plots=_PLOTS,
        shown_rows=_ROWS,
        sections=_sections(content),
    )


def _sections(content: Content) -> dict[str, str]:
    """id -> title of the sections that are not empty, in order."""
    parts = {
        "summary": True,
        "strips": content.strips,
        "figures": content.figures,
        "curves": content.plots,
        "ablations": content.ablations,
        "paper": content.paper,
        "scenes": content.scenes,
        "comparisons": content.comparisons,
        "sfm": content.sfm,
        "raw": content.raw,
    }
    return {key: title for key, title in TITLES.items() if parts[key]}


def viewer_link(strip: Strip, out: Path) -> str:
    """Relative address of the run's viewer at the strip's view, half of it the truth."""
    assert strip.viewer is not None
    path = os.path.relpath(strip.viewer.resolve(), out.resolve())
    return f"{quote(path)}#view={quote(strip.view)}&compare=wipe"


def pieces(text: str) -> list[str]:
    """`text` split where a line may break: after / _ and =."""
    return re.split(r"(?<=[/_=])", text)


def _svg_uri(svg: str) -> str:
    return _data_uri("image/svg+xml", svg.encode())


def _webp_uri(webp: bytes) -> str:
    return _data_uri("image/webp", webp)


def _data_uri(mime: str, content: bytes) -> str:
    return f"data:{mime};base64,{base64.b64encode(content).decode()}"
