"""Writes and reads a folder in the D-NeRF layout with a few small random images."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
from PIL import Image

from datasets.scene import Scene
from datasets.settings import SceneConfig
from datasets.source import open_source

SIZE = 8
ANGLE_X = 0.7


def blender_pose(x: float, z: float = 4.0) -> list[list[float]]:
    """Camera-to-world, Blender axes: position (x, 0, z), viewing direction -z."""
    return [[1.0, 0.0, 0.0, float(x)], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, z], [0.0, 0.0, 0.0, 1.0]]


def write_split(root: Path, split: str, count: int, *, timed: bool = True, seed: int = 0) -> None:
    rng = np.random.default_rng(seed)
    (root / split).mkdir(parents=True)
    frames = []
    for index in range(count):
        name = f"r_{index:03d}" if split == "test" else f"r_{index}"
        Image.fromarray(rng.integers(0, 256, (SIZE, SIZE, 4), dtype=np.uint8)).save(root / split / f"{name}.png")
        frames.append(
            {"file_path": f"./{split}/{name}", "rotation": 0.1, "transform_matrix": blender_pose(float(index))}
        )
        if timed:
            frames[-1]["time"] = index / max(count - 1, 1)
    write_json(root / f"transforms_{split}.json", {"camera_angle_x": ANGLE_X, "frames": frames})


def write_json(path: Path, content: object) -> None:
    path.write_text(json.dumps(content))


def edit(root: Path, change: Callable[[dict], None], split: str = "train") -> None:
    path = root / f"transforms_{split}.json"
    content = json.loads(path.read_text())
    change(content)
    write_json(path, content)


def write_folder(root: Path) -> Path:
    """Three training views, two of each held-out split."""
    for number, (split, count) in enumerate((("train", 3), ("val", 2), ("test", 2))):
        write_split(root, split, count, seed=number)
    return root


def read(folder: Path, log: Callable[[str], None] = lambda line: None, **options: object) -> Scene:
    """By the reader of the layout, over black."""
    cfg = SceneConfig("toy", "dnerf", str(folder), **{"background": "black", **options})
    return open_source(cfg, log=log).scene()
