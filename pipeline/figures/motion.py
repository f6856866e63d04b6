"""The test view that shows most motion, and in it rendered optical flow beside the true one, or OpenCV's; and paths."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from matplotlib.collections import LineCollection

from datasets.ground_truth import GroundTruth
from pipeline.data.optical_flow import measure_flow, neighbours, resized_flow
from pipeline.data.training_views import Target, evenly_spaced, target_of
from pipeline.evaluation.image_metrics import flow_errors
from pipeline.evaluation.moving_pixels import MovingPixels
from pipeline.evaluation.pictures.false_colour import flow_picture
from pipeline.evaluation.pictures.view_pictures import flow_parts, longest_flow
from pipeline.evaluation.renderer import Renderer
from pipeline.figures.figure import Figure, canvas, panels, png_of, show
from rasterizer.reference.render import project_point, slice_in_time, world_to_camera

CANDIDATES = 60  # test views looked at, evenly spread
PATHS, PATH_TIMES = 200, 60  # paths drawn at most; times of each

TRUE, MEASURED = "true", "OpenCV's"  # whose flow a GroundTruth has


@dataclass(frozen=True)
class MovingView:
    """A test view at the final resolution."""

    target: Target
    index: int  # among the test views
    moving: np.ndarray | None  # (H, W) bool; None: unknown
    known: GroundTruth | None  # with flow, if `source` is not None
    source: str | None  # of the flow: TRUE, MEASURED, or None: there is none

    @property
    def truth(self) -> np.ndarray:
        """(H, W, 3) in [0, 1]."""
        return self.target.image.numpy().transpose(1, 2, 0)


def most_moving(renderer: Renderer) -> MovingView:
    """The test view with most moving pixels; the middle one where it is unknown what moves."""
    scene, scale = renderer.scene, renderer.cfg.train.resolution_scale
    pixels, views = MovingPixels(scene, scale), scene.test
    following = neighbours(views, max_gap=scene.duration)  # what is too far to follow is not trusted
    indices = np.unique(np.linspace(0, len(views) - 1, min(len(views), CANDIDATES)).round().astype(int)).tolist()
    counts = {i: 0 if (mask := pixels.of(i)) is None else int(mask.sum()) for i in indices}
    middle = len(views) / 2
    best = max(indices, key=lambda i: (counts[i], -abs(i - middle)))
    target, known = target_of(views[best], scale), pixels.truth_of(best)
    moving = pixels.of(best, known)
    if known is not None and known.flow is not None:
        return MovingView(target, best, moving, known, TRUE)
    if best not in following:
        return MovingView(target, best, moving, known, None)
    other = views[following[best]]
    flow = resized_flow(
        measure_flow(np.asarray(views[best].image), np.asarray(other.image)), target.camera.width, target.camera.height
    ).numpy()
    found = replace(
        known or GroundTruth(),
        flow=np.nan_to_num(flow) * target.camera.width,
        flow_valid=np.isfinite(flow[0]),
        flow_dt=other.time - views[best].time,
    )
    return MovingView(target, best, moving, found, MEASURED)


def flow_figure(renderer: Renderer, view: MovingView) -> Figure:
    """Of a model with time. Flow is to `flow_dt` later, the next frame where no truth says otherwise."""
    target, known = view.target, view.known
    step = renderer.scene.frame_spacing if known is None or known.flow_dt is None else known.flow_dt
    found = renderer.geometry(target.camera, target.time, step)
    assert found.flow is not None
    render = (f"{target.name}, render", renderer.image(target.camera, target.time))
    if known is None or known.flow is None or known.flow_valid is None:
        longest = longest_flow(found.flow, np.ones(found.flow.shape[1:], bool))
        drawn = panels([render, (f"rendered flow, full colour {longest:.1f} px", flow_picture(found.flow, longest))])
        seen = (
            f"Between two frames the model moves what is coloured, by up to {longest:.1f} px; no camera stands still "
            "in the test views, so that no flow measured in them is comparable."
        )
        return Figure("flow", "Optical flow", seen, png_of(drawn))
    counted = known.flow_valid if view.moving is None else known.flow_valid & view.moving
    longest = longest_flow(known.flow, known.flow_valid)
    whose = "true flow" if view.source == TRUE else "flow by OpenCV"
    rendered, true, error = flow_parts(found, known)
    drawn = panels(
        [
            render,
            (f"rendered flow, full colour {longest:.1f} px", rendered),
            (whose, true),
            (f"end-point error, yellow {longest:.1f} px", error),
        ]
    )
    return Figure(
        "flow", "Optical flow", _seen(flow_errors(found.flow, known.flow, counted), whose, view), png_of(drawn)
    )


def _seen(errors: dict[str, float | None], whose: str, view: MovingView) -> str:
    error, length, share = (errors.get(name) for name in ("flow_error_px", "flow_true_px", "flow_error"))
    if error is None or length is None:
        return f"Nothing that moves has a known flow in {view.target.name}."
    pixels = "pixels that move" if view.moving is not None else "pixels with a known flow"
    verdict = "" if share is None else f", {share:.2f} of it: 0 would be exact, 1 is a model at rest"
    return (
        f"On the {pixels} the {whose} is {length:.2f} px long on average and the rendered flow is off by {error:.2f} px"
        f"{verdict}."
    )


def paths_figure(renderer: Renderer, view: MovingView) -> Figure:
    """Of a model with shared trajectories: where Gaussians of the more opaque half go, also behind others."""
    scene, camera, gaussians = renderer.scene, view.target.camera, renderer.model.gaussians()
    opaque = gaussians.opacity_logit.argsort(descending=True)[: (len(gaussians) + 1) // 2]
    chosen = gaussians.rows(opaque[evenly_spaced(len(opaque), PATHS)])
    times = np.linspace(scene.time_start, scene.time_end, PATH_TIMES)
    points = torch.stack([world_to_camera(slice_in_time(chosen, float(t)).mean, camera) for t in times], dim=1)
    paths = project_point(points[(points[..., 2] > 0).all(dim=1)], camera).numpy()  # (n, PATH_TIMES, 2)
    figure = canvas(5.4, 5.4 * camera.height / camera.width + 0.4)
    axis = figure.subplots()
    show(axis, f"{view.target.name}, render; paths", 0.4 * renderer.image(camera, view.target.time))
    lines = np.stack([paths[:, :-1], paths[:, 1:]], axis=2).reshape(-1, 2, 2) - 0.5  # a pixel's centre is its index
    drawn = LineCollection(list(lines), array=np.tile(times[:-1], len(paths)), cmap="viridis", linewidths=0.8)
    axis.add_collection(drawn)
    figure.colorbar(drawn, ax=axis, label="t", shrink=0.8)
    lengths = np.linalg.norm(np.diff(paths, axis=1), axis=2).sum(axis=1)
    median, longest = (np.median(lengths), lengths.max()) if len(lengths) else (0.0, 0.0)
    seen = (
        f"Paths of {len(paths)} Gaussians over all of the scene's time: half of them are longer than {median:.1f} px, "
        f"the longest is {longest:.1f} px."
    )
    return Figure("paths", "Paths of Gaussians", seen, png_of(figure))
