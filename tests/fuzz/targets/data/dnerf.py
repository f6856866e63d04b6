"""Target datasets/readers/dnerf.py: transforms files and PNGs."""

from __future__ import annotations

import io
import json
from pathlib import Path

import numpy as np
from dnerf_folder import blender_pose
from hypothesis.strategies import SearchStrategy
from PIL import Image

from datasets.settings import SceneConfig
from datasets.source import open_source
from fuzz.edits.bytes import changed_files
from fuzz.edits.json import edit_json
from fuzz.scene_checks import check_scene
from fuzz.target import Changes, Files, Target, valid_or_refused

SIZE = 6
VIEWS = 2  # of each split
INTRINSICS = {
    "train": {"camera_angle_x": 0.7},
    "test": {"w": SIZE, "h": SIZE, "fl_x": 8.0, "fl_y": 8.5, "cx": 3.0, "cy": 2.5, "k1": -0.1, "p1": 0.01},
}


def png(seed: int, width: int = SIZE, height: int = SIZE, channels: int = 4) -> bytes:
    pixels = np.random.default_rng(seed).integers(0, 256, (height, width, channels), dtype=np.uint8)
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, "PNG")
    return file.getvalue()


def example() -> Files:
    files: Files = {}
    for number, split in enumerate(("train", "test")):
        frames = [
            {
                "file_path": f"./{split}/r_{i}",
                "time": i / VIEWS,
                "rotation": 0.1,
                "transform_matrix": blender_pose(i + 0.5 * number),
            }
            for i in range(VIEWS)
        ]
        files[f"transforms_{split}.json"] = json.dumps({**INTRINSICS[split], "frames": frames}).encode()
        files |= {f"{split}/r_{i}.png": png(10 * number + i) for i in range(VIEWS)}
    return files


def changes(files: Files) -> SearchStrategy[Changes]:
    return changed_files(files, {".json": edit_json})


def check(folder: Path) -> str:
    with valid_or_refused(folder) as outcome:
        cfg = SceneConfig("fuzz/dnerf", "dnerf", str(folder))
        check_scene(open_source(cfg, log=lambda line: None).scene())
    return outcome[0]


TARGET = Target("dnerf", "the D-NeRF layout: transforms_*.json and PNGs", example, changes, check)
