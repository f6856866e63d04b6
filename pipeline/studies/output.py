"""What the studies write: files replaced atomically, CSV text, SVG text."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from datasets.files.atomic_write import atomic_file


def write_results(folder: Path, files: Mapping[str, str | Callable[[Path], object]]) -> str:
    """Replaces each file, given as its text or as a function that writes to a path; returns the line that names them.

    To be called before anything is printed: printing stops where a pipe is closed.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        with atomic_file(folder / name) as path:
            if isinstance(content, str):
                path.write_text(content, encoding="utf-8")
            else:
                content(path)
    return f"written to {folder}: {', '.join(files)}"


def csv_text(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    return buffer.getvalue()


@contextmanager
def svg_style(salt: str, **settings: Any) -> Iterator[None]:
    """Fonts of a figure, and ids made from `salt`: the same drawing gives the same bytes."""
    style: dict[Any, Any] = {"svg.hashsalt": salt, "font.family": "DejaVu Sans", "font.size": 9.5}
    with matplotlib.rc_context(style | settings):
        yield


def svg_figure(width: float, height: float, **options: Any) -> Figure:
    """An empty white figure, in inches."""
    figure = Figure(figsize=(width, height), facecolor="white", **options)
    FigureCanvasSVG(figure)
    return figure


def svg_text(figure: Figure) -> str:
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    return buffer.getvalue()
