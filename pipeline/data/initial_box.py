"""Where random initial points are drawn: as scene.init_box says, else in the usual box if the cameras bear it out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from datasets.camera_box import are_alike, band_of_depths, box_around_frusta, box_of_cameras
from datasets.scene import Box, Scene


def with_set_box(scene: Scene, box: list[float]) -> Scene:
    """A scene in canonical coordinates with the cube of scene.init_box."""
    return replace(scene, init_box=(box[0], box[1]))


def with_box_of_cameras(scene: Scene) -> tuple[Scene, str]:
    """(A scene in canonical coordinates with the place that its cameras see, that in words; "" if it is as it was)."""
    cameras = [view.camera for view in scene.train]
    box = box_of_cameras(cameras)
    if box is None:
        near, far = band_of_depths(cameras)
        found = replace(scene, init_box=box_around_frusta(cameras, far), init_depths=(near, far))
        return found, f"at depths of {near:.3g} to {far:.3g} before the cameras, which look at nothing in common"
    if are_alike(scene.init_box, box) or scene.capture == "monocular":  # which films a subject
        return scene, ""
    return replace(scene, init_box=box), f"in {box_in_words(box)}, which most of the cameras see"


def box_in_words(box: Box) -> str:
    """ "[-1.2 -1.2 -1.2] to [1.2 1.2 1.2]" """
    low, high = (np.round(np.broadcast_to(np.asarray(corner, np.float64), 3), 3) for corner in box)
    return f"{low} to {high}"
