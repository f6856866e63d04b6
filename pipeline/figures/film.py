"""A film of new views, bullet_time.mp4, and a strip of its frames."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pipeline.evaluation.pictures.camera_path import bullet_time
from pipeline.evaluation.pictures.view_pictures import path_of, write_bullet_time
from pipeline.evaluation.renderer import Renderer
from pipeline.figures.figure import Figure, panels, png_of

FILE = "bullet_time.mp4"
FRAMES = 5  # of the strip, of each turn


def film_figure(renderer: Renderer, folder: Path) -> Figure:
    """Also writes the film into `folder`."""
    scene = renderer.scene
    write_bullet_time(folder / FILE, renderer)
    ellipse, intrinsics = path_of(renderer)
    path = bullet_time(ellipse, intrinsics, scene.time_start, scene.duration)
    chosen = [path[i] for i in np.linspace(0, len(path), 2 * FRAMES, endpoint=False).astype(int)]
    images = [(f"t = {frame.time:.2f}", renderer.image(frame.camera, frame.time)) for frame in chosen]
    seen = (
        f"{FILE}: once round among the training cameras while time stands still (above), then once more while it runs "
        "(below)."
    )
    return Figure("film", "New views", seen, png_of(panels(images, FRAMES)))
