"""The data set's cameras and, of as many views as fit, the ground truth; what a viewer jumps to."""

from __future__ import annotations

import io
import re
from dataclasses import dataclass

import numpy as np
from PIL import Image

from datasets.scene import Scene, View
from pipeline.data.training_views import camera_at, evenly_spaced
from rasterizer import Camera

MOST_TRUTHS = 48  # images, the held-out ones first
MOST_BYTES = 4 * 2**20  # of all of them
LONGEST_SIDE = 800  # pixels; larger ones are reduced
QUALITY = 90  # of WebP


@dataclass(frozen=True)
class Cameras:
    header: list[dict]  # of each camera: name, split, intrinsics, world_to_cam and its frames
    truths: list[dict]  # of each image: offset and size in `data`
    data: bytes


def cameras_of(scene: Scene, scale: float, with_truths: bool = True, renders: int = 0) -> Cameras:
    """scale: of the images, as in training (training_views.camera_at). renders: how many test views have pictures in
    the run's folder (`evaluate.renders`), whose images come first."""
    views = [*scene.test, *scene.train]
    held_out = len(scene.test)
    truths: list[dict] = []
    data, of_view = bytearray(), {}
    for index in _worth_showing(held_out, len(scene.train), renders) if with_truths else ():
        image = _encoded(views[index], camera_at(views[index].camera, scale))
        if len(data) + len(image) > MOST_BYTES:
            continue
        of_view[index] = len(truths)
        truths.append({"offset": len(data), "size": len(image)})
        data += image
    cameras: dict[tuple, dict] = {}
    for index, view in enumerate(views):
        split = "held out" if index < held_out else "training"
        camera = camera_at(view.camera, scale)
        filmed = scene.frame_rate is not None
        name = re.sub(r"_\d+$", "", view.name) if filmed else view.name
        key = (split, name)
        if key not in cameras:
            cameras[key] = {"name": name, "split": split, **_intrinsics(camera), "frames": []}
        linked = view.name.replace("/", "_")  # as its pictures have it (docs/conventions.md), and links to it
        cameras[key]["frames"].append({"time": view.time, "view": linked, "truth": of_view.get(index)})
    for found in cameras.values():
        found["frames"].sort(key=lambda frame: frame["time"])
    return Cameras(list(cameras.values()), truths, bytes(data))


def _intrinsics(camera: Camera) -> dict:
    return {
        **{name: getattr(camera, name) for name in ("width", "height", "fx", "fy", "cx", "cy")},
        "world_to_cam": camera.world_to_cam.ravel().tolist(),
    }


def _worth_showing(held_out: int, training: int, renders: int) -> list[int]:
    """Indices of the views whose images are embedded: held-out ones, then training ones, each evenly spaced. Before
    them those of the pictures in the run's folder, which the report's links open."""
    pictured = evenly_spaced(held_out, renders)
    if len(pictured) > MOST_TRUTHS:
        pictured = [pictured[i] for i in evenly_spaced(len(pictured), MOST_TRUTHS)]
    others = [index for index in evenly_spaced(held_out, MOST_TRUTHS) if index not in pictured]
    test = pictured + [others[i] for i in evenly_spaced(len(others), MOST_TRUTHS - len(pictured))]
    return test + [held_out + index for index in evenly_spaced(training, MOST_TRUTHS - len(test))]


def _encoded(view: View, camera: Camera) -> bytes:
    image = Image.fromarray(np.asarray(view.image))
    shrink = min(1.0, LONGEST_SIDE / max(camera.width, camera.height))
    size = (max(1, round(camera.width * shrink)), max(1, round(camera.height * shrink)))
    if image.size != size:
        image = image.resize(size, Image.Resampling.BOX)
    buffer = io.BytesIO()
    image.save(buffer, "WEBP", quality=QUALITY, method=0)
    return buffer.getvalue()
