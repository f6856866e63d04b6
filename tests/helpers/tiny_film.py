"""Tiny video scenes: one of several cameras, those of tiny.py, two of them held out; one of a textured plane."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter
from tiny import SIZE, tiny_scene

from datasets.scene import Scene, View, camera_extent

RATE = 10.0  # frames a second
PLANE = (96, 128)  # height and width of the textured plane's images
PLANE_DEPTH, FOCAL = 4.0, 40.0  # of the plane, world units; of tiny_scene's cameras, pixels
PANNED = 3  # pixels


def tiny_film(frames: int = 4, height: int = SIZE, held_out: tuple[str, ...] = ("cam00", "cam05")) -> Scene:
    """A red disc that moves to the right, in three training cameras and those `held_out`."""
    cameras = [replace(view.camera, height=height, cy=height / 2) for view in tiny_scene().train[:4]]

    def filmed(split: str, name: str, camera: int) -> list[View]:
        views = []
        for frame in range(frames):
            y, x = np.mgrid[:height, :SIZE] + 0.5
            image = np.zeros((height, SIZE, 3), np.uint8)
            image[(x - (10 + 3 * frame)) ** 2 + (y - 16) ** 2 < 36] = (220, 60, 30)
            views.append(View(cameras[camera], frame / RATE, image, f"{split}/{name}_{frame:04d}", filmed_by=name))
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
        "multi_view",
        frame_rate=RATE,
    )


def unsynchronised_film(frames: int = 30) -> Scene:
    """Four training cameras that stand still, 30 frames a second, which started 0, 4, 11 and 7 ms after the first."""
    film = tiny_film(frames)
    cameras = [film.train[i * frames].camera for i in range(3)] + [film.test[0].camera]
    train = [
        View(
            camera,
            offset + frame / 30,
            film.train[frame].image,
            f"train/cam{number:02d}_{frame:04d}",
            filmed_by=f"{number}",
        )
        for number, (camera, offset) in enumerate(zip(cameras, (0.0, 0.004, 0.011, 0.007), strict=True))
        for frame in range(frames)
    ]
    return replace(
        film, train=tuple(train), duration=0.011 + frames / 30, frame_rate=30.0, playback_rate=30.0, test=film.test[:2]
    )


def texture(seed: int = 0) -> np.ndarray:
    """(3 H, 3 W) in [0, 255], of PLANE: noise without details below two pixels."""
    noise = np.random.default_rng(seed).normal(size=(3 * PLANE[0], 3 * PLANE[1]))
    smooth = gaussian_filter(noise, 1.5)
    return np.clip(127 + 50 * smooth / smooth.std(), 0, 255)


def plane_image(right: int, down: int) -> np.ndarray:
    """(H, W, 3) uint8: the middle of the texture, moved by so many pixels."""
    y, x = PLANE[0] - down, PLANE[1] - right
    grey = np.rint(texture()[y : y + PLANE[0], x : x + PLANE[1]]).astype(np.uint8)
    return np.repeat(grey[..., None], 3, axis=2)


def moving_plane() -> Scene:
    """One camera's four frames of the textured plane, which moves by 2 pixels right and 1 down a frame."""
    film = tiny_film(frames=4)
    height, width = PLANE
    camera = replace(film.train[0].camera, width=width, height=height, cx=width / 2, cy=height / 2)
    frames = [plane_image(2 * frame, frame) for frame in range(4)]
    views = tuple(replace(v, camera=camera, image=i) for v, i in zip(film.train, frames))
    return replace(film, train=views, capture="clip")


def clip_past_a_plane() -> Scene:
    """Four frames of the textured plane, which stands still, by a camera that moves sideways: PANNED pixels a frame."""
    film = moving_plane()
    views = [
        replace(view, camera=replace(view.camera, world_to_cam=_moved(view.camera.world_to_cam, frame * PANNED)))
        for frame, view in enumerate(film.train)
    ]
    views = [replace(v, image=plane_image(PANNED * frame, 0)) for frame, v in enumerate(views)]
    return replace(film, train=tuple(views), frame_rate=None, playback_rate=RATE)


def _moved(world_to_cam: np.ndarray, pixels: float) -> np.ndarray:
    """The pose that sees a point at PLANE_DEPTH on the optical axis that many pixels further to the right."""
    pose = world_to_cam.copy()
    pose[0, 3] += pixels * PLANE_DEPTH / FOCAL
    return pose
