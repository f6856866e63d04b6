"""Target datasets/urban/waymo.py: a processed scene and one in KITTI's format, with masks."""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path

import numpy as np
from hypothesis.strategies import SearchStrategy
from kitti_format import write_kitti_format

from datasets.readers.waymo import open_waymo
from datasets.settings import SceneConfig
from datasets.urban.assemble import scene_of_log
from datasets.urban.write import Frame, FrameCamera, write_processed
from fuzz.edits.bytes import changed_files, edit_text
from fuzz.scene_checks import check_scene
from fuzz.target import Changes, Files, Target, read_files, valid_or_refused
from rasterizer.camera import Camera

FRAMES, WIDTH, HEIGHT = 3, 12, 8
LOOKS_FORWARD = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])


def frame(index: int) -> Frame:
    rng = np.random.default_rng(index)
    pose = np.eye(4)
    pose[0, 3] = 1.5 * index
    camera = Camera(WIDTH, HEIGHT, 10.0, 10.0, 6.0, 4.0, LOOKS_FORWARD @ np.linalg.inv(pose))
    mask = np.zeros((HEIGHT, WIDTH), bool)
    mask[:2] = True
    image = rng.integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8)
    seen = FrameCamera(0, camera, image, (-0.1, 0.01, 0.0, 0.0, 0.0), mask, ~mask)
    points = pose[:3, 3] + rng.uniform((4, -2, -1), (20, 2, 1), (12, 3))
    return Frame(0.1 * index, pose, (seen,), points)


@cache
def example() -> Files:
    with tempfile.TemporaryDirectory() as folder:
        for index in range(FRAMES):
            write_processed(Path(folder) / "processed", index, frame(index))
            write_kitti_format(Path(folder) / "kitti_format", index, frame(index))
        return read_files(Path(folder))


def changes(files: Files) -> SearchStrategy[Changes]:
    return changed_files(files, {".txt": edit_text})


def check(folder: Path) -> str:
    with valid_or_refused(folder) as outcome:
        for layout in ("processed", "kitti_format"):
            cfg = SceneConfig(name="fuzz/waymo", reader="waymo", test_every=3, downscale=1)
            check_scene(scene_of_log(open_waymo(folder / layout), cfg))
    return outcome[0]


TARGET = Target("waymo", "Waymo: a processed scene and one in KITTI's format", example, changes, check)
