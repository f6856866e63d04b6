"""Target datasets/plenoptic/images.py: the image form of the Plenoptic layout."""

from __future__ import annotations

import json
from pathlib import Path

from dnerf_folder import blender_pose
from hypothesis.strategies import SearchStrategy

from datasets.settings import SceneConfig
from datasets.source import open_source
from fuzz.edits.bytes import changed_files
from fuzz.edits.json import edit_json
from fuzz.scene_checks import check_scene
from fuzz.target import Changes, Files, Target, valid_or_refused
from fuzz.targets.data.dnerf import png

WIDTH, HEIGHT, FRAMES = 8, 6, 2
INTRINSICS = {"w": 8.0, "h": 6.0, "fl_x": 7.0, "fl_y": 7.5, "cx": 4, "cy": 3, "k1": 0.01, "camera_model": "OPENCV"}


def example() -> Files:
    files: Files = {}
    for split, cameras in (("train", (1, 2)), ("test", (0,))):
        frames = [
            {
                "file_path": f"images/cam{camera:02d}_{frame:04d}",
                "time": frame / 30,
                "transform_matrix": blender_pose(camera),
            }
            for camera in cameras
            for frame in range(FRAMES)
        ]
        files[f"transforms_{split}.json"] = json.dumps({**INTRINSICS, "frames": frames}).encode()
        files |= {
            f"images/cam{camera:02d}_{frame:04d}.png": png(10 * camera + frame, WIDTH, HEIGHT, 3)
            for camera in cameras
            for frame in range(FRAMES)
        }
    return files


def changes(files: Files) -> SearchStrategy[Changes]:
    return changed_files(files, {".json": edit_json})


def check(folder: Path) -> str:
    with valid_or_refused(folder) as outcome:
        cfg = SceneConfig("fuzz/images", "plenoptic", str(folder), cache=str(folder / "cache"))
        check_scene(open_source(cfg, threads=1, log=lambda text: None).scene())
    return outcome[0]


TARGET = Target("images", "the Plenoptic layout as images: transforms_*.json and PNGs", example, changes, check)
