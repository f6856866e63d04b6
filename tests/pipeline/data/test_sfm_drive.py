"""Cameras of a clip that is filmed along the camera's axis, as from a car: through a textured passage."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from datasets.source import Photograph
from pipeline.config.schema import InitConfig
from pipeline.data.sfm.clip import reconstruct_clip

WIDTH, HEIGHT, FOCAL = 400, 140, 240.0  # pixels; as wide as a car's camera
HALF = 2.0, 1.2  # metres: half the width and height of the passage
TEXELS = 24  # a metre


def texture(seed: int) -> np.ndarray:
    """(H, W) float32 in [0, 255]: noise of several sizes."""
    rng = np.random.default_rng(seed)
    layers = [
        cv2.resize(rng.uniform(0, 1, (96 // size, 1536 // size)), (1536, 96), interpolation=cv2.INTER_CUBIC)
        for size in (1, 3, 8)
    ]
    return (255 * np.clip(np.mean(layers, axis=0), 0, 1)).astype(np.float32)


def passage(forward: float, textures: list[np.ndarray]) -> np.ndarray:
    """(H, W, 3) uint8: the view ahead after so many metres; black beyond 50 metres."""
    x, y = np.meshgrid((np.arange(WIDTH) + 0.5 - WIDTH / 2) / FOCAL, (np.arange(HEIGHT) + 0.5 - HEIGHT / 2) / FOCAL)
    image = np.zeros((HEIGHT, WIDTH), np.float32)
    side, depth_side, depth_floor = np.abs(x) * HALF[1] > np.abs(y) * HALF[0], HALF[0] / np.abs(x), HALF[1] / np.abs(y)
    depth = np.where(side, depth_side, depth_floor)
    across = np.where(side, y, x) * depth
    along = (depth + forward).astype(np.float32) * TEXELS
    rows = ((across + 2) * TEXELS).astype(np.float32)
    walls = np.where(side, np.where(x < 0, 0, 1), np.where(y < 0, 2, 3))
    for wall, pattern in enumerate(textures):
        seen = cv2.remap(pattern, along % pattern.shape[1], rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
        image = np.where((walls == wall) & (depth < 50), seen, image)
    return np.repeat(np.rint(image).astype(np.uint8)[..., None], 3, axis=2)


def driven(count: int, step: float) -> list[Photograph]:
    textures = [texture(wall) for wall in range(4)]
    return [Photograph(f"frame_{i:05d}", passage(step * i, textures)) for i in range(count)]


def test_frames_from_a_car_are_registered() -> None:
    """All of them, at even steps along one line."""
    found = reconstruct_clip(driven(9, 0.3), InitConfig(min_points=50), Path("clip"), lambda line: None)
    positions = np.stack([found.cameras[name].camera.position for name in sorted(found.cameras)])
    steps = np.diff(positions, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    assert len(positions) == 9
    assert lengths.std() < 0.05 * lengths.mean()
    assert (steps @ steps.sum(axis=0) / np.linalg.norm(steps.sum(axis=0)) > 0.99 * lengths).all()


def test_the_advice_is_for_a_car() -> None:
    """Far apart: neighbours share what is at the end of the passage, the others hardly anything."""
    with pytest.raises(ValueError, match=r"^clip: expected .* found .*; a car's video needs many frames a second"):
        reconstruct_clip(driven(8, 3.0), InitConfig(min_points=50), Path("clip"), lambda line: None)
