"""Which pixels of the test views show something that moves.

Known for scenes with ground truth (datasets/ground_truth.py) and for driving logs (Scene.moving_by). Elsewhere, where a
held-out camera stands still, a pixel counts as moving if its true colour changes over the camera's test views; that
includes shadows and changing lights.
"""

from __future__ import annotations

from collections import Counter

import numpy as np

from datasets.ground_truth import GroundTruth, any_moving
from datasets.scene import Scene, View
from pipeline.data.training_views import camera_at

COLOUR_CHANGE = 0.1  # max - min of any channel over a still camera's views, of full scale
STILL_VIEWS = 3  # least number of test views of one pose for a mask by colour
BY_TRUTH, BY_COLOUR = "ground truth", f"change of colour above {COLOUR_CHANGE} in a still camera's views"


class MovingPixels:
    """The masks of a scene's test views at the final resolution of training. Masks by colour are kept."""

    def __init__(self, scene: Scene, scale: float) -> None:
        self._views, self._scale, self._moving_by = scene.test, scale, scene.moving_by
        self._by_pose: dict[bytes, np.ndarray] = {}
        views_of = Counter(map(_pose, scene.test))
        filmed = {pose for pose, views in views_of.items() if views >= STILL_VIEWS}
        self._still = set() if scene.capture == "static" else filmed

    def of(self, index: int, truth: GroundTruth | None = None) -> np.ndarray | None:
        """(H, W) bool of test view `index`; None: unknown. truth: of the view, if it has been read."""
        view = self._views[index]
        camera = camera_at(view.camera, self._scale)
        truth = truth or self.truth_of(index, moving_only=True)
        if truth is not None and truth.moving is not None:
            return truth.moving
        if view.moving is not None:
            return any_moving(view.moving, camera.width, camera.height)
        if (pose := _pose(view)) not in self._still:
            return None
        if pose not in self._by_pose:
            moving = changing_colour([other for other in self._views if _pose(other) == pose])
            self._by_pose[pose] = any_moving(moving, camera.width, camera.height)
        return self._by_pose[pose]

    def truth_of(self, index: int, moving_only: bool = False) -> GroundTruth | None:
        """The ground truth of test view `index` at the final resolution; None: it has none."""
        view = self._views[index]
        camera = camera_at(view.camera, self._scale)
        return None if view.truth is None else view.truth.read(moving_only).resized(camera.width, camera.height)

    def source(self, index: int) -> str | None:
        """BY_TRUTH, BY_COLOUR, Scene.moving_by or None, by what the mask of test view `index` is known."""
        if self.of(index) is None:
            return None
        if self._views[index].moving is not None and self._views[index].truth is None:
            return self._moving_by
        return BY_COLOUR if _pose(self._views[index]) in self._by_pose else BY_TRUTH


def changing_colour(views: list[View]) -> np.ndarray:
    """(H, W) bool: whether max - min over `views`, of one pose and size, is above COLOUR_CHANGE in any channel."""
    lowest = highest = np.asarray(views[0].image)
    for view in views[1:]:
        image = np.asarray(view.image)
        lowest, highest = np.minimum(lowest, image), np.maximum(highest, image)
    return (highest - lowest > 255 * COLOUR_CHANGE).any(axis=-1)


def _pose(view: View) -> bytes:
    return view.camera.world_to_cam.tobytes()
