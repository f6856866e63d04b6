"""A tiny multi-camera video scene, with the cameras of tiny.py; two of them are held out."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from tiny import SIZE, tiny_scene

from datasets.scene import Scene, View, camera_extent

RATE = 10.0  # frames a second


def tiny_film(frames: int = 4, height: int = SIZE, held_out: tuple[str, ...] = ("cam00", "cam05")) -> Scene:
    """A red disc that moves to the right, in three training cameras and those `held_out`."""
    cameras = [replace(view.camera, height=height, cy=height / 2) for view in tiny_scene().train[:4]]

    def filmed(split: str, name: str, camera: int) -> list[View]:
        views = []
        for frame in range(frames):
            y, x = np.mgrid[:height, :SIZE] + 0.5
            image = np.zeros((height, SIZE, 3), np.uint8)
            image[(x - (10 + 3 * frame)) ** 2 + (y - 16) ** 2 < 36] = (220, 60, 30)
            views.append(View(cameras[camera], frame / RATE, image, f"{split}/{name}_{frame:04d}"))
        return views

    train = [view for i in (0, 1, 2) for view in filmed("train", f"cam{i + 1:02d}", i)]
    test = [view for i, name in enumerate(held_out) for view in filmed("test", name, 3 - 2 * i)]
    # Sorted by time, with the cameras in turn.
    test.sort(key=lambda view: view.time)
    return Scene(
        "tiny_film",
        tuple(train),
        tuple(test),
        (frames - 1) / RATE,
        0.0,
        (0.0, 0.0, 0.0),
        camera_extent(cameras),
        (-1.2, 1.2),
        Path("tiny_film"),
        frame_rate=RATE,
    )
