"""Images and videos of an evaluation: render, ground truth and difference as PNG, and a bullet-time video."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from PIL import Image

from datasets.files.atomic_write import atomic_file
from datasets.scene import Scene
from pipeline.config.schema import Config
from pipeline.data.training_views import camera_at, evenly_spaced
from pipeline.evaluation.camera_path import FRAME_RATE, bullet_time, ellipse_among, median_depth
from pipeline.evaluation.films import video
from pipeline.evaluation.motion.moving_pixels import MovingPixels
from pipeline.evaluation.renderer import Renderer

DIFFERENCE_GAIN = 4  # brightness of a difference image relative to |render - truth|, clipped at white

NEAREST_DEPTH = 4.0  # metres, and nearer: the brightest of a depth image, whose brightness falls as 1/√depth

SaveImages = Callable[[str, np.ndarray, np.ndarray], None]  # (view name, render, truth), images (H, W, 3) in [0, 1]


def png_saver(folder: Path) -> SaveImages:
    """A function that writes <view>_render.png, <view>_truth.png and <view>_difference.png into `folder`.

    Slashes in the view's name become _. The difference is |render - truth| × DIFFERENCE_GAIN, clipped.
    """
    folder.mkdir(exist_ok=True)

    def save(name: str, image: np.ndarray, truth: np.ndarray) -> None:
        difference = np.clip(np.abs(image - truth) * DIFFERENCE_GAIN, 0.0, 1.0)
        for kind, picture in (("render", image), ("truth", truth), ("difference", difference)):
            with atomic_file(folder / f"{name.replace('/', '_')}_{kind}.png") as temporary:
                Image.fromarray(np.round(picture * 255.0).astype(np.uint8)).save(temporary)

    return save


def write_moving(folder: Path, scene: Scene, cfg: Config) -> None:
    """<view>_moving.png of the test views that `cfg.evaluate.renders` selects: white what moves; none where unknown."""
    moving = MovingPixels(scene, cfg.train.resolution_scale)
    for index in evenly_spaced(len(scene.test), cfg.evaluate.renders):
        if (mask := moving.of(index)) is not None:
            with atomic_file(folder / f"{scene.test[index].name.replace('/', '_')}_moving.png") as temporary:
                Image.fromarray(mask).save(temporary)


def write_depths(folder: Path, renderer: Renderer) -> None:
    """<view>_depth.png of a driving log's test views that `cfg.evaluate.renders` selects: near is bright."""
    import matplotlib

    scene, cfg = renderer.scene, renderer.cfg
    for index in evenly_spaced(len(scene.test), cfg.evaluate.renders):
        view = scene.test[index]
        geometry = renderer.geometry(camera_at(view.camera, cfg.train.resolution_scale), view.time, None)
        metres = geometry.depth / (scene.metre or 1.0)
        shade = np.where(metres > 0, np.clip(NEAREST_DEPTH / np.maximum(metres, 1e-6), 0, 1) ** 0.5, 0)
        picture = matplotlib.colormaps["magma"](shade)[..., :3]
        with atomic_file(folder / f"{view.name.replace('/', '_')}_depth.png") as temporary:
            Image.fromarray(np.round(picture * 255).astype(np.uint8)).save(temporary)


def write_bullet_time(path: Path, renderer: Renderer) -> None:
    """A video along camera_path's ellipse among the training cameras, with the intrinsics of the first test camera."""
    scene, scale = renderer.scene, renderer.cfg.train.resolution_scale
    cameras, intrinsics = [view.camera for view in scene.train], camera_at(scene.test[0].camera, scale)
    points, sphere = renderer.model.parameters["mean"][:, :3], renderer.model.sphere
    depth = median_depth((points if sphere is None else points[~sphere]).numpy(), intrinsics)
    ellipse = ellipse_among(cameras, default_depth=depth or scene.extent)
    with video(path, intrinsics.width, intrinsics.height, FRAME_RATE) as send:
        for frame in bullet_time(ellipse, intrinsics, scene.time_start, scene.duration):
            send(renderer.image(frame.camera, frame.time))
