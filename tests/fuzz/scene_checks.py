"""The check of every scene that a reader returns, independent of datasets.scene.validate_scene."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from datasets.scene import Scene
from datasets.settings import SceneConfig
from datasets.source import detect, open_source
from fuzz.target import require


def check_scene(scene: Scene) -> None:
    """RuleViolation if an invariant does not hold; reads every image."""
    require(bool(scene.train) and bool(scene.test), "a split is empty")
    views = scene.train + scene.test
    require(len({view.name for view in views}) == len(views), "duplicate view names")
    low, high = scene.init_box
    numbers = [
        scene.duration,
        scene.time_start,
        scene.extent,
        scene.unit,
        *np.ravel(low),
        *np.ravel(high),
        *scene.background,
    ]
    require(bool(np.isfinite(np.float32(numbers)).all()), f"a number beyond float32: {numbers}")
    require(scene.duration > 0 and scene.extent > 0 and scene.unit > 0, f"a size of zero or less: {numbers}")
    require(bool(np.less(low, high).all()), f"init_box {scene.init_box}")
    first = views[0].camera
    for view in views:
        camera, image = view.camera, np.asarray(view.image)
        require(
            image.dtype == np.uint8 and image.shape == (camera.height, camera.width, 3),
            f"{view.name} has an image {image.dtype} {image.shape}",
        )
        require((camera.width, camera.height) == (first.width, first.height), f"{view.name} has another size")
        require(scene.time_start <= view.time <= scene.time_end, f"{view.name} is at {view.time}")
        intrinsics = np.float32([camera.fx, camera.fy, camera.cx, camera.cy])
        require(bool(np.isfinite(intrinsics).all() and (intrinsics[:2] > 0).all()), f"{view.name} has {intrinsics}")
        pose = camera.world_to_cam
        rotation = pose[:3, :3]
        require(
            bool(
                np.isfinite(np.float32(pose)).all()
                and np.abs(rotation @ rotation.T - np.eye(3)).max() < 0.01
                and np.linalg.det(rotation) > 0
                and np.isfinite(np.float32(camera.position)).all()
            ),
            f"{view.name} stands at {pose.tolist()}",
        )


def check_layout(layout: str, folder: Path) -> None:
    """What scene=auto does with a folder of this layout: it is recognised, or refused, and read."""
    detect(folder)
    cfg = SceneConfig("fuzz", layout, str(folder), test_every=3, downscale=0)
    check_scene(open_source(cfg, log=lambda line: None).scene())
