"""Scenes and models for the viewer's tests, and a page that shows them."""

from __future__ import annotations

import base64
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
import torch
from builders import camera_looking_at, generator, random_gaussians
from playwright.sync_api import Browser, Page
from tiny import tiny_config, tiny_scene

from datasets.scene import Scene, View, camera_extent
from pipeline.model.environment_map import EnvironmentMap
from pipeline.model.model import Model
from pipeline.view.viewer import Shown, write_viewer
from rasterizer import Camera
from rasterizer.gaussians import Motion

SIZE = (120, 90)  # of the pictures, pixels
WAIT_MS = 10_000  # for what a click does


def viewed_scene(static: bool = False, views: int = 6) -> Scene:
    """Cameras around the cube of `viewed_model`, their images of ramps; every other one is held out too."""
    made = []
    for i in range(views):
        angle = 2 * np.pi * i / views
        camera = camera_looking_at((3.5 * np.sin(angle), -1.0, -3.5 * np.cos(angle)), *SIZE, focal=110)
        image = np.full((SIZE[1], SIZE[0], 3), 20 * i, np.uint8)
        image[:, :, 0] = np.linspace(0, 255, SIZE[0], dtype=np.uint8)
        made.append(View(camera, 0.0 if static else i / (views - 1), image, f"train/r_{i}"))
    test = tuple(replace(view, name=view.name.replace("train", "test")) for view in made[::2])
    extent = camera_extent([view.camera for view in made])
    return replace(tiny_scene(), train=tuple(made), test=test, extent=extent, background=(0.1, 0.2, 0.3))


def viewed_model(motion: Motion | Literal["shared"], fourier_order: int = 0, count: int = 300) -> Model:
    """Gaussians that fade, move and change their colour as strongly as trained ones, or more."""
    return Model.from_gaussians(random_gaussians(count, motion, generator(3), 3, fourier_order).to(torch.float32))


def always_there(model: Model) -> Model:
    """The same Gaussians for a thousand times as long, as those that share trajectories are trained."""
    log_scale = model.parameters["log_scale"] + torch.tensor([0.0, 0.0, 0.0, 7.0])
    return model.with_parameters({**model.parameters, "log_scale": log_scale})


def over_environment_map(model: Model) -> Model:
    """The same model over a smooth map, also of values beyond [0, 1]."""
    rows, columns = np.mgrid[:16, :32] / 16
    image = np.stack([rows, 1.2 * np.sin(3 * columns) ** 2, 1 - rows * columns / 2]).astype(np.float32)
    return Model(model.kind, model.parameters, environment_map=EnvironmentMap(torch.from_numpy(image)))


def write_page(path: Path, scene: Scene, *models: Model) -> str:
    """Writes a viewer of the models; its address on disk."""
    write_viewer(path, [Shown(f"model {i}", model, 20.0) for i, model in enumerate(models)], scene, tiny_config())
    return path.resolve().as_uri()


@contextmanager
def opened(browser: Browser, url: str, size: tuple[int, int] = (640, 300), has_touch: bool = False) -> Iterator[Page]:
    """A page that is ready. What goes wrong in it fails the test."""
    page = browser.new_page(viewport={"width": size[0], "height": size[1]}, has_touch=has_touch)
    page.on("pageerror", lambda error: pytest.fail(f"the page raised {error}"))
    page.on("console", lambda said: pytest.fail(f"the page said {said.text}") if said.type == "error" else None)
    page.set_default_timeout(WAIT_MS)
    page.goto(url)
    page.wait_for_selector("body.ready", timeout=60_000)  # the first shader may take long
    try:
        yield page
    finally:
        page.close()


def picture(page: Page, camera: Camera, time: float, model: int = 0) -> np.ndarray:
    """(H, W, 3) in [0, 1], drawn by the page in the camera's own pixels."""
    pinhole = {name: getattr(camera, name) for name in ("width", "height", "fx", "fy", "cx", "cy")}
    script = """async ([camera, time, model]) =>
        btoa(String.fromCharCode(...await viewer.picture(camera, time, model)))"""
    text = page.evaluate(script, [{**pinhole, "world_to_cam": camera.world_to_cam.ravel().tolist()}, time, model])
    pixels = np.frombuffer(base64.b64decode(text), np.uint8)
    return pixels.reshape(camera.height, camera.width, 4)[..., :3] / 255
