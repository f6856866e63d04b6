"""Reads folders as scene=auto does, and compares scenes with what layout_folders writes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from layout_folders import COUNT, HEIGHT, WIDTH, cameras, picture
from PIL import Image

from datasets.scene import Scene
from datasets.settings import SceneConfig
from datasets.source import open_source


def read(path: Path, **settings: object) -> tuple[Scene, list[str]]:
    """The scene of scene=auto, and the lines that it logs."""
    lines: list[str] = []
    cfg = SceneConfig(**{"name": "x", "reader": "auto", "path": str(path), "downscale": 0, **settings})
    return open_source(cfg, log=lines.append).scene(), lines


def check(scene: Scene, order: list[int] | None = None) -> None:
    """Cameras and pixels are those written; by time, `order` of the COUNT places."""
    views = sorted(scene.train + scene.test, key=lambda view: view.time)
    for view, index in zip(views, order or range(COUNT), strict=True):
        expected = cameras()[index]
        np.testing.assert_allclose(view.camera.world_to_cam, expected.world_to_cam, atol=1e-6)
        found = [getattr(view.camera, name) for name in ("fx", "fy", "cx", "cy")]
        np.testing.assert_allclose(found, [50, 50, 20, 15], rtol=1e-9)
        assert (np.asarray(view.image) == picture(index)).all()


def write_ramp(images: Path) -> None:
    """Makes all images a ramp of grey along x, 6 levels a pixel."""
    ramp = np.repeat(np.broadcast_to(np.arange(WIDTH)[None, :, None] * 6, (HEIGHT, WIDTH, 1)), 3, axis=2)
    for path in images.iterdir():
        Image.fromarray(ramp.astype(np.uint8)).save(path)


def check_ramp(scene: Scene, source: np.ndarray, focal: float = 50.0) -> None:
    """Row 15 is the ramp as a lens shows it. source: (WIDTH,), where it images the row's pixels, in focal lengths."""
    image = np.asarray(scene.train[0].image)[15, :, 0].astype(float)
    expected = 6 * (focal * source + 20 - 0.5)
    inside = (expected > 2) & (expected < 6 * (WIDTH - 2))
    np.testing.assert_allclose(image[inside], expected[inside], atol=1.0)  # 8 bits, and 1/32 pixel of OpenCV's maps


def row_15(focal: float = 50.0) -> tuple[np.ndarray, float]:
    """x / z (WIDTH,) and y / z of that row's pixel centres."""
    return (np.arange(WIDTH) + 0.5 - 20) / focal, (15.5 - 15) / focal


def fisheye(coefficients: tuple[float, ...], focal: float = 50.0) -> np.ndarray:
    """(WIDTH,): where a fisheye lens images that row, in focal lengths: x times its formula of the angle."""
    x, y = row_15(focal)
    radius = np.hypot(x, y)
    theta = np.arctan(radius)
    bent = 1 + sum(k * theta ** (2 * power) for power, k in enumerate(coefficients, 1))
    return x * theta * bent / radius
