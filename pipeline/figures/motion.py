"""Rendered optical flow beside the true one, or beside OpenCV's where the truth is unknown."""

from __future__ import annotations

import numpy as np

from pipeline.evaluation.image_metrics import flow_errors
from pipeline.evaluation.pictures.false_colour import flow_picture
from pipeline.evaluation.pictures.geometry_pictures import flow_parts, longest_flow
from pipeline.evaluation.renderer import Renderer
from pipeline.figures.figure import Figure, panels, png_of
from pipeline.figures.moving_view import TRUE, MovingView


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
