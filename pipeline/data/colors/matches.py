"""The colours of the points of structure from motion in the photographs that see them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from datasets.source import Photograph
from pipeline.data.sfm.reconstruction import Reconstruction

# Pixels: a colour is a Gaussian mean, as a feature at an edge moves by a fraction of a pixel from image to image.
BLUR, REACH = 1.5, 7
DARKEST, BRIGHTEST = 4, 251  # of 255: what is clipped, or next to it, says nothing of the exposure


@dataclass(frozen=True)
class Matches:
    """A row for each point and each camera that sees it, clipped colours left out; in the order of the points."""

    point: np.ndarray  # (M,) int, row of the point in the reconstruction
    camera: np.ndarray  # (M,) int, place in `cameras`
    color: np.ndarray  # (M, 3) float64, of 255
    cameras: tuple[str, ...]

    def where(self, rows: np.ndarray) -> Matches:
        """The rows of a mask (M,) bool."""
        return Matches(self.point[rows], self.camera[rows], self.color[rows], self.cameras)

    def shared(self) -> Matches:
        """The points that two cameras see, or more."""
        count = np.bincount(self.point, minlength=1)
        return self.where(count[self.point] > 1)

    def count(self, camera: int) -> int:
        return int((self.camera == camera).sum())


def matched_colors(photographs: Sequence[Photograph], found: Reconstruction) -> Matches:
    """The colours at `found.observations`; of a camera that sees a point in several photographs, their mean."""
    assert found.observations is not None
    images = {photograph.name: photograph for photograph in photographs}
    names = list(found.cameras)
    cameras = tuple(dict.fromkeys(images[name].camera_name for name in names))
    keys, colors = [], []
    for place, name in enumerate(names):
        seen = found.observations[found.observations[:, 1] == place]
        image = images[name].image
        column, row = (np.clip(seen[:, 2 + i].astype(int), 0, image.shape[1 - i] - 1) for i in (0, 1))
        color = cv2.GaussianBlur(image, (REACH, REACH), BLUR)[row, column].astype(np.float64)
        window = np.ones((REACH, REACH), np.uint8)
        darkest, brightest = cv2.erode(image, window)[row, column], cv2.dilate(image, window)[row, column]
        whole = (darkest >= DARKEST).all(axis=1) & (brightest <= BRIGHTEST).all(axis=1)
        keys.append(seen[whole, 0].astype(int) * len(cameras) + cameras.index(images[name].camera_name))
        colors.append(color[whole])
    distinct, place_of, count = np.unique(np.concatenate(keys), return_inverse=True, return_counts=True)
    total = np.stack(
        [np.bincount(place_of, channel, minlength=len(distinct)) for channel in np.concatenate(colors).T], axis=1
    )
    return Matches(distinct // len(cameras), distinct % len(cameras), total / count[:, None], cameras)
