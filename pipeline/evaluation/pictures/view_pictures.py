"""Images and videos of an evaluation: render, ground truth and difference as PNG, and a bullet-time video."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
from PIL import Image

from datasets.files.atomic_write import atomic_file
from datasets.scene import Scene, View
from pipeline.config.schema import Config
from pipeline.data.training_views import camera_at, evenly_spaced, target_of
from pipeline.evaluation.moving_pixels import MovingPixels
from pipeline.evaluation.pictures.camera_path import FRAME_RATE, Ellipse, bullet_time, ellipse_among, median_depth
from pipeline.evaluation.pictures.films import video
from pipeline.evaluation.renderer import Renderer
from rasterizer import Camera

DIFFERENCE_GAIN = 4  # brightness of a difference image relative to |render - truth|, clipped at white

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


def path_of(renderer: Renderer) -> tuple[Ellipse, Camera]:
    """The ellipse among the training cameras, and a camera with the intrinsics of its images."""
    scene, scale = renderer.scene, renderer.cfg.train.resolution_scale
    cameras, intrinsics = [view.camera for view in scene.train], camera_at(scene.test[0].camera, scale)
    points, sphere = renderer.model.parameters["mean"][:, :3], renderer.model.sphere
    depth = median_depth((points if sphere is None else points[~sphere]).numpy(), intrinsics)
    return ellipse_among(cameras, default_depth=depth or scene.extent), intrinsics


def write_bullet_time(path: Path, renderer: Renderer) -> None:
    """A video along camera_path's ellipse among the training cameras, with the intrinsics of the first test camera."""
    scene = renderer.scene
    ellipse, intrinsics = path_of(renderer)
    with video(path, intrinsics.width, intrinsics.height, FRAME_RATE) as send:
        for frame in bullet_time(ellipse, intrinsics, scene.time_start, scene.duration):
            send(renderer.image(frame.camera, frame.time))


def write_clip_films(folder: Path, renderer: Renderer, frame_rate: float) -> None:
    """Three videos of cameras that move: path_render_and_truth.mp4, every frame beside its render (held-out ones
    included, one camera after the other, in order of time); still_camera.mp4, all times of one camera seen by its
    middle frame; and bullet_time.mp4."""
    scene, scale = renderer.scene, renderer.cfg.train.resolution_scale

    places = Counter(view.camera.world_to_cam.tobytes() for view in scene.train + scene.test)

    def taker(view: View) -> str:
        place = view.camera.world_to_cam.tobytes()
        return view.filmed_by or (
            place.hex() if places[place] > 1 else ""
        )  # a held-out camera that stands still beside a clip

    views = sorted(scene.train + scene.test, key=lambda view: (taker(view), view.time))
    middle = views[len(views) // 2]
    still = camera_at(middle.camera, scale)
    width, height = still.width, still.height
    with video(folder / "path_render_and_truth.mp4", 2 * width, height, frame_rate) as send:
        for view in views:
            target = target_of(view, scale)
            image = renderer.image(target.camera, target.time)
            send(np.concatenate([image, target.image.numpy().transpose(1, 2, 0)], axis=1))
    with video(folder / "still_camera.mp4", width, height, frame_rate) as send:
        for view in views:
            if taker(view) == taker(middle):
                send(renderer.image(still, view.time))
    write_bullet_time(folder / "bullet_time.mp4", renderer)
