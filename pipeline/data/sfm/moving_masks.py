"""What moves in the frames of a clip: pixels whose optical flow disagrees with the motion of the camera.

The flow of a still point lies on its epipolar line. The residual is Sampson's distance to it, in pixels of the image
that flow is measured in; a pixel moves if it exceeds the limit towards the frame before and the frame after, because
at an edge that covers or uncovers something flow is wrong in one of the two. What moves along its epipolar line is not
found.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import cv2
import numpy as np

from datasets.clip.survey import textured
from datasets.source import Photograph
from pipeline.data.sfm.reconstruction import CalibratedCamera
from rasterizer.camera import Camera

WIDTH = 384  # pixels: of the images that flow is measured in
STEPS = (1, 2, 3, 5, 8)  # frames: the first in which the camera has moved enough is compared
PARALLAX = 2.0  # pixels, of a point at the median depth: with less, the direction of the epipolar lines is uncertain
LEAST_RESIDUAL, RESIDUAL_DEVIATIONS = 1.0, 4.0  # pixels; × the residuals' scaled median absolute deviation
LARGEST_SHARE = 0.7  # of a picture; a mask that covers more is wrong
GROWN = 5  # pixels: a mask is grown by this, as the features at its edge see what moves too


def moving_masks(
    photographs: Sequence[Photograph], cameras: Mapping[str, CalibratedCamera], points: np.ndarray
) -> dict[str, np.ndarray]:
    """Name -> (H, W) bool, True where it moves, of the frames with a camera; frames without neighbours are left out.

    photographs: in order of time. points: (N, 3) of the reconstruction, for the depth of the scene.
    """
    known = [photograph for photograph in photographs if photograph.name in cameras]
    scale = min(1.0, WIDTH / known[0].image.shape[1]) if known else 1.0
    size = (round(known[0].image.shape[1] * scale), round(known[0].image.shape[0] * scale)) if known else (0, 0)
    greys = [cv2.resize(cv2.cvtColor(p.image, cv2.COLOR_RGB2GRAY), size, interpolation=cv2.INTER_AREA) for p in known]
    posed = [cameras[p.name].camera.resized(*size) for p in known]
    found = {}
    for index, photograph in enumerate(known):
        residuals = []
        for direction in (-1, 1):
            other = _neighbour(posed, index, direction, points)
            if other is not None:
                residuals.append(_residual(greys[index], greys[other], posed[index], posed[other]))
        if not residuals:
            continue
        mask = np.logical_and.reduce([residual > _limit(residual) for residual in residuals]).astype(np.uint8)
        mask[~textured(greys[index])] = 0
        mask = cv2.morphologyEx(mask, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
        mask = cv2.dilate(mask, np.ones((2 * GROWN + 1,) * 2, np.uint8))
        if mask.mean() <= LARGEST_SHARE:
            height, width = photograph.image.shape[:2]
            found[photograph.name] = cv2.resize(mask, (width, height), interpolation=cv2.INTER_NEAREST).astype(bool)
    return found


def _neighbour(cameras: Sequence[Camera], index: int, direction: int, points: np.ndarray) -> int | None:
    """The nearest frame with enough parallax in one direction of time, within STEPS; None if none has."""
    camera = cameras[index]
    depths = points @ camera.world_to_cam[2, :3] + camera.world_to_cam[2, 3]
    depth = float(np.median(depths[depths > 0])) if (depths > 0).any() else 1.0
    for step in STEPS:
        other = index + direction * step
        if not 0 <= other < len(cameras):
            break
        if camera.fx * np.linalg.norm(cameras[other].position - camera.position) / depth >= PARALLAX:
            return other
    return None


def _residual(image: np.ndarray, other: np.ndarray, camera: Camera, other_camera: Camera) -> np.ndarray:
    """(H, W) float32 Sampson distance of each pixel's flow, pixels."""
    search = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    flow = np.asarray(search.calc(image, other, None))  # type: ignore[call-overload]
    height, width = image.shape
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    here = np.stack([x, y, np.ones_like(x)], axis=-1)
    there = np.stack([x + flow[..., 0], y + flow[..., 1], np.ones_like(x)], axis=-1)
    matrix = fundamental_matrix(camera, other_camera)
    line, back = here @ matrix.T, there @ matrix
    error = (there * line).sum(axis=-1)
    slope = np.square(line[..., :2]).sum(axis=-1) + np.square(back[..., :2]).sum(axis=-1)
    return (np.abs(error) / np.sqrt(np.maximum(slope, 1e-20))).astype(np.float32)


def fundamental_matrix(camera: Camera, other: Camera) -> np.ndarray:
    """(3, 3) F with x_otherᵀ F x = 0 for the pixels (x, y, 1) of a still point; its norm is 1."""
    relative = other.world_to_cam @ np.linalg.inv(camera.world_to_cam)
    rotation, shift = relative[:3, :3], relative[:3, 3]
    cross = np.array([[0, -shift[2], shift[1]], [shift[2], 0, -shift[0]], [-shift[1], shift[0], 0]])
    matrix = np.linalg.inv(_intrinsics(other)).T @ cross @ rotation @ np.linalg.inv(_intrinsics(camera))
    return matrix / max(float(np.linalg.norm(matrix)), 1e-20)


def _intrinsics(camera: Camera) -> np.ndarray:
    return np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])


def _limit(residual: np.ndarray) -> float:
    deviation = 1.4826 * float(np.median(np.abs(residual - np.median(residual))))
    return max(LEAST_RESIDUAL, float(np.median(residual)) + RESIDUAL_DEVIATIONS * deviation)
