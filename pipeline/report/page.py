"""Renders report.html from page.html: one self-contained page with inline images and without scripts."""

from __future__ import annotations

import base64
import os
import re
from functools import partial
from pathlib import Path
from urllib.parse import quote

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from pipeline.presentation.table_layout import laid_out
from pipeline.report.content import Content
from pipeline.report.strips import Strip

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
    return environment.get_template("page.html").render(
        content=content,
        laid_out=laid_out,
        shown_cards=_CARDS,
        shown_scenes=_SCENES,
        shown_plots=_PLOTS,
        shown_rows=_ROWS,
        sections=content.sections,
    )


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
