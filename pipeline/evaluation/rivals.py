"""What a model must beat to have learnt anything: pictures that need no model, compared with held-out views.

nearest_view   the training view that is nearest in pose, and of one pose in time
mean_picture   the mean over its times of the training camera that is nearest in pose; where no camera filmed twice, the
               mean of all training views

All are compared at SIDE pixels, where a small parallax costs the rivals little.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from datasets.scene import Scene, View
from pipeline.data.training_views import Target, camera_at, evenly_spaced, target_of
from pipeline.evaluation.quick_evaluate import valid_psnr
from pipeline.evaluation.renderer import Renderer
from rasterizer import Camera

SIDE = 128  # pixels of the longer side
BLUR = 1.0  # dB
COMPARED = 30  # held-out views at most, evenly spread
AVERAGED = 24  # views at most in a mean picture, evenly spread


@dataclass(frozen=True)
class AgainstRivals:
    """PSNR in dB, means over the same held-out views at SIDE pixels."""

    model: float
    nearest_view: float
    mean_picture: float

    @property
    def learnt(self) -> bool:
        """Whether the model shows more than a blur: each camera's own blur is a little better than the mean picture."""
        return self.model > self.mean_picture + BLUR

    @property
    def beaten(self) -> bool:
        """Whether the model is better than both rivals."""
        return self.learnt and self.model > self.nearest_view

    def __str__(self) -> str:
        return (
            f"{self.model:.1f} dB; the nearest training view {self.nearest_view:.1f} dB, the mean of training views "
            f"{self.mean_picture:.1f} dB"
        )


class Rivals:
    """The rivals' pictures of a scene's held-out views, made once and compared as often as wanted."""

    def __init__(self, scene: Scene, scale: float = 1.0) -> None:
        """scene: in canonical coordinates. scale: × the size of its images, at which models are evaluated."""
        self._scale = scale
        views = [scene.test[index] for index in evenly_spaced(len(scene.test), COMPARED)]
        cameras = _by_pose(scene.train)
        filmed = len(cameras) < len(scene.train)
        pictures: dict[int, np.ndarray] = {}  # by place of the camera; -1: of all
        self._views = [(view, _small(view, scale)) for view in views]
        nearest, means = [], []
        for view, target in self._views:
            place = nearest_pose(view.camera, [of_pose[0].camera for of_pose in cameras])
            own = cameras[place]
            closest = min(own, key=lambda other: abs(other.time - view.time))
            nearest.append(_psnr(_picture(closest, scale), target))
            averaged = place if filmed else -1
            if averaged not in pictures:
                pictures[averaged] = mean_picture(own if filmed else scene.train, scale)
            means.append(_psnr(pictures[averaged], target))
        self._nearest, self._mean = float(np.mean(nearest)), float(np.mean(means))

    def compare(self, renderer: Renderer) -> AgainstRivals:
        """The renderer's model, rendered at the size of an evaluation and then reduced."""
        model = []
        for view, target in self._views:
            model.append(_psnr(renderer.image(camera_at(view.camera, self._scale), view.time), target))
        return AgainstRivals(float(np.mean(model)), self._nearest, self._mean)


def nearest_pose(camera: Camera, others: Sequence[Camera]) -> int:
    """The place of the camera that is nearest to `camera`: the angle between them in radians plus the distance, in
    mean distances of `others` from the origin, where they look in canonical coordinates."""
    positions = np.stack([other.position for other in others])
    rotations = np.stack([other.world_to_cam[:3, :3] for other in others])
    reach = max(float(np.linalg.norm(positions, axis=1).mean()), 1e-12)
    cosine = 0.5 * (np.einsum("nij,ij->n", rotations, camera.world_to_cam[:3, :3]) - 1)
    angle = np.arccos(np.clip(cosine, -1, 1))
    return int(np.argmin(angle + np.linalg.norm(positions - camera.position, axis=1) / reach))


def mean_picture(views: Sequence[View], scale: float = 1.0) -> np.ndarray:
    """(H, W, 3) float32 in [0, 1], at the size of the first view reduced."""
    chosen = [_picture(views[index], scale) for index in evenly_spaced(len(views), AVERAGED)]
    return np.stack([_resized(picture, chosen[0].shape) for picture in chosen]).mean(axis=0)


def _by_pose(views: Sequence[View]) -> list[list[View]]:
    """The views of each pose, in the order of the first ones."""
    found: dict[bytes, list[View]] = defaultdict(list)
    for view in views:
        found[view.camera.world_to_cam.tobytes()].append(view)
    return list(found.values())


def _small(view: View, scale: float) -> Target:
    return target_of(view, min(scale, SIDE / max(view.camera.width, view.camera.height)))


def _picture(view: View, scale: float) -> np.ndarray:
    return _small(view, scale).image.numpy().transpose(1, 2, 0)


def _resized(image: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    if image.shape == shape:
        return image
    return cv2.resize(np.ascontiguousarray(image), shape[1::-1], interpolation=cv2.INTER_AREA)


def _psnr(image: np.ndarray, target: Target) -> float:
    truth = target.image.numpy().transpose(1, 2, 0)
    return valid_psnr(_resized(image, truth.shape), truth, target)
