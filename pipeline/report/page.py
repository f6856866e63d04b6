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
    environment.filters |= {"data_uri": _data_uri, "pieces": pieces, "viewer_link": partial(viewer_link, out=out)}
    return environment.get_template("page.html").render(content=content, laid_out=laid_out, sections=content.sections)


def viewer_link(strip: Strip, out: Path) -> str:
    """Relative address of the run's viewer at the strip's view, half of it the truth."""
    assert strip.viewer is not None
    path = os.path.relpath(strip.viewer.resolve(), out.resolve())
    return f"{quote(path)}#view={quote(strip.view)}&compare=wipe"


def pieces(text: str) -> list[str]:
    """`text` split where a line may break: after / _ and =."""
    return re.split(r"(?<=[/_=])", text)


def _data_uri(content: bytes | str, mime: str) -> str:
    content = content.encode() if isinstance(content, str) else content
    return f"data:{mime};base64,{base64.b64encode(content).decode()}"
