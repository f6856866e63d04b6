"""Joins page/ to one HTML file: opened from disk, a page can load neither modules nor workers nor data.

Its scripts are modules, each an idea with its imports stated. Joined, they share one scope in the order that their
imports ask for; the import and export keywords fall away.
"""

from __future__ import annotations

import base64
import html
import json
import re
from collections.abc import Sequence
from functools import cache
from pathlib import Path

from pipeline.evaluation.pictures.view_pictures import DIFFERENCE_GAIN
from rasterizer.reference.blend import MAX_ALPHA, MIN_ALPHA
from rasterizer.reference.render import FRUSTUM_MARGIN

FOLDER = Path(__file__).parent / "page"
SHADERS = {
    "cover": "cover.vert",
    "preprocess": "preprocess.frag",
    "splatCorners": "splat.vert",
    "splat": "splat.frag",
    "compose": "compose.frag",
}
CONSTANTS = {
    "MIN_ALPHA": MIN_ALPHA,
    "MAX_ALPHA": MAX_ALPHA,
    "FRUSTUM_MARGIN": FRUSTUM_MARGIN,
    "DIFFERENCE_GAIN": float(DIFFERENCE_GAIN),
}

_IMPORT = re.compile(r'^import \{[^}]*\} from "\./([\w-]+\.js)";\n', re.MULTILINE)
_EXPORT = re.compile(r"^export (?=(async function|function|class|const|let)\b)", re.MULTILINE)
_DECLARED = re.compile(r"^(?:async function|function|class|const|let) ([\w$]+)", re.MULTILINE)


def page(title: str, header: dict, truths: bytes, models: Sequence[bytes]) -> str:
    """The HTML text. header: what main.js reads; models: the data of each of header["models"], by pack.py."""
    data = [_element("header", "application/json", json.dumps(header).replace("<", "\\u003c"))]
    data.append(_element("truths", "application/octet-stream", base64.b64encode(truths).decode()))
    data += [
        _element(f"model-{index}", "application/octet-stream", base64.b64encode(model).decode())
        for index, model in enumerate(models)
    ]
    return _frame().replace("<!-- title -->", html.escape(title)).replace("<!-- data -->", "\n".join(data))


@cache
def _frame() -> str:
    """page.html with everything but the title and the data."""
    shaders = [_element(f"shader-{name}", "x-shader/x-glsl", shader(file)) for name, file in SHADERS.items()]
    parts = {
        "style": f"<style>\n{_read('style.css')}</style>",
        "data": "\n".join([*shaders, _element("sorter", "text/plain", _read("sorter.js")), "<!-- data -->"]),
        "script": f'<script>\n"use strict";\n(() => {{\n{joined("main.js")}}})();\n</script>',
    }
    text = _read("page.html")
    for name, part in parts.items():
        text = text.replace(f"<!-- {name} -->", part)
    return text


def shader(file: str) -> str:
    """The source of a shader, with the kernel's constants."""
    text = _read(f"shaders/{file}")
    for name, value in CONSTANTS.items():
        text = re.sub(rf"\b{name}\b", repr(float(value)), text)
    return text


def joined(main: str) -> str:
    """The scripts that `main` needs and itself, as one. ValueError for a name that two of them declare."""
    found: dict[str, str] = {}
    declared: dict[str, str] = {}

    def add(file: str) -> None:
        if file in found:
            return
        text = _read(file)
        found[file] = ""  # in work: a circle of imports ends here
        for imported in _IMPORT.findall(text):
            add(imported)
        del found[file]  # after what it imports
        body = _EXPORT.sub("", _IMPORT.sub("", text))
        for name in _DECLARED.findall(body):
            if name in declared:
                raise ValueError(f"page/{file} and page/{declared[name]}: both declare {name}, but share a scope")
            declared[name] = file
        found[file] = f"// ---- {file}\n{body.strip()}\n\n"

    add(main)
    return "".join(found.values())


def _element(name: str, kind: str, content: str) -> str:
    return f'<script type="{kind}" id="{name}">\n{content}\n</script>'


def _read(file: str) -> str:
    return (FOLDER / file).read_text(encoding="utf-8")
