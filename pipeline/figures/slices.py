"""x-t slices: one row of pixels of a fixed camera, over time. What moves draws a curve, what rests a vertical line."""

from __future__ import annotations

import numpy as np

from pipeline.data.training_views import target_of
from pipeline.evaluation.renderer import Renderer
from pipeline.figures.figure import Figure, canvas, png_of
from pipeline.figures.motion import MovingView

STEPS = 200  # times of a rendered slice, at most 4 for each of the scene's


def slices_figure(renderer: Renderer, view: MovingView, other: tuple[str, Renderer] | None = None) -> Figure:
    """The row with most motion of the view's camera; the truth beside it where that camera stands still in the data.

    other: name and model of another run of the scene, drawn between the two.
    """
    scene, camera = renderer.scene, view.target.camera
    count = min(STEPS, 4 * scene.frame_count)
    times = np.linspace(scene.time_start, scene.time_end, count)
    row = _row(view, renderer, times)
    models = [("render", renderer), *([] if other is None else [other])]
    parts = [(name, np.stack([one.image(camera, float(time))[row] for time in times])) for name, one in models]
    changes = [f"{np.abs(np.diff(image, axis=0)).sum(axis=0).mean():.2f}" for _, image in parts]  # of (T, W, 3)
    pose = scene.test[view.index].camera.world_to_cam
    same = sorted((v for v in scene.test if np.array_equal(v.camera.world_to_cam, pose)), key=lambda v: v.time)
    scale = renderer.cfg.train.resolution_scale
    if len(same) > 2:
        parts.append(("truth", np.stack([target_of(v, scale).image.numpy()[:, row].T for v in same])))
    figure = canvas(4.2 * (1 + len(parts)), 3.6)
    axes = figure.subplots(1, 1 + len(parts))
    axes[0].imshow(np.clip(view.truth, 0, 1))
    axes[0].axhline(row, color="#ff00c8", lw=1)
    axes[0].set_title(f"{view.target.name}, truth; the row", fontsize=9, loc="left")
    axes[0].set_axis_off()
    for axis, (title, image) in zip(axes[1:], parts):
        extent = (0, camera.width, scene.time_end, scene.time_start)
        axis.imshow(np.clip(image, 0, 1), aspect="auto", extent=extent, interpolation="nearest")
        axis.set(xlabel="x, pixels", ylabel="t")
        axis.set_title(f"{title}, row {row}", fontsize=9, loc="left")
    compared = "" if other is None else f", of {other[0]} by {changes[1]}"
    beside = f"; its true frames are beside it ({len(same)} of them)" if parts[-1][0] == "truth" else ""
    seen = (
        f"Row {row} over time, {count} rendered moments: what rests draws vertical lines, what moves slanted ones; a "
        f"pixel changes by {changes[0]} of full scale in all{compared}{beside}."
    )
    return Figure("slices", "Slices through time", seen, png_of(figure))


def _row(view: MovingView, renderer: Renderer, times: np.ndarray) -> int:
    """The row with most moving pixels; where they are unknown, with most change over time in the render."""
    if view.moving is not None and view.moving.any():
        return int(view.moving.sum(axis=1).argmax())
    lowest = highest = renderer.image(view.target.camera, float(times[0]))
    for time in times[1:]:
        image = renderer.image(view.target.camera, float(time))
        lowest, highest = np.minimum(lowest, image), np.maximum(highest, image)
    return int((highest - lowest).sum(axis=(1, 2)).argmax())
