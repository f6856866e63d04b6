"""A figure: a picture, and one sentence on what is seen in it."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure as Canvas

DPI = 110
FILE = "figures.json"  # of a run's folder figures/: a list of {file, title, seen}


@dataclass(frozen=True)
class Figure:
    name: str  # of its file, without suffix
    title: str
    seen: str  # one sentence, with the numbers of this run
    png: bytes

    @property
    def file(self) -> str:
        return f"{self.name}.png"


def canvas(width: float, height: float) -> Canvas:
    """An empty white picture, inches."""
    figure = Canvas(figsize=(width, height), dpi=DPI, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def png_of(figure: Canvas) -> bytes:
    """The same drawing gives the same bytes."""
    buffer = io.BytesIO()
    with matplotlib.rc_context({"font.family": "DejaVu Sans", "font.size": 9}):
        figure.savefig(buffer, format="png", metadata={"Software": None})
    return buffer.getvalue()


def panels(images: Sequence[tuple[str, np.ndarray]], columns: int | None = None) -> Canvas:
    """Titled images (H, W, 3) of one size, in rows of `columns`."""
    columns = columns or len(images)
    rows = -(-len(images) // columns)
    height, width = images[0][1].shape[:2]
    side = 3.0 if columns < 5 else 2.2
    figure = canvas(side * columns, rows * (side * height / width + 0.35))
    axes = np.atleast_1d(figure.subplots(rows, columns)).ravel()
    for axis in axes[len(images) :]:
        axis.set_visible(False)
    for axis, (title, image) in zip(axes, images):
        show(axis, title, image)
    return figure


def show(axis: Axes, title: str, image: np.ndarray) -> None:
    axis.imshow(np.clip(image, 0.0, 1.0), interpolation="nearest")
    axis.set_title(title, fontsize=9, loc="left")
    axis.set_axis_off()
