"""Target datasets/plenoptic/videos.py: the video form of the Plenoptic layout, with decoding."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from hypothesis.strategies import SearchStrategy
from plenoptic_folder import write_video

from datasets.settings import SceneConfig
from datasets.source import open_source
from fuzz.edits.arrays import edit_npy
from fuzz.edits.bytes import changed_files
from fuzz.scene_checks import check_scene
from fuzz.target import Changes, Files, Target, valid_or_refused
from fuzz.targets.data.poses import NAMES, SIZE, poses_file

FRAMES = 3


def example() -> Files:
    return {"poses_bounds.npy": poses_file(), **{f"{name}.mp4": _video(number) for number, name in enumerate(NAMES)}}


def _video(seed: int) -> bytes:
    """An mp4 file of FRAMES frames; its index comes first, so that changed files can often be decoded."""
    width, height = SIZE
    pixels = np.random.default_rng(seed).integers(0, 256, (FRAMES, height // 8, width // 8, 3), dtype=np.uint8)
    pixels = pixels.repeat(8, axis=1).repeat(8, axis=2)
    with tempfile.TemporaryDirectory() as temporary:
        path = Path(temporary) / "video.mp4"
        write_video(path, list(pixels), 30, "-crf", "30")
        return path.read_bytes()


def changes(files: Files) -> SearchStrategy[Changes]:
    return changed_files(files, {".npy": edit_npy})


def check(folder: Path) -> str:
    with valid_or_refused(folder) as outcome:
        cfg = SceneConfig("fuzz/videos", "plenoptic", str(folder), cache=str(folder / "cache"))
        check_scene(open_source(cfg, threads=1, log=lambda text: None).scene())
    return outcome[0]


TARGET = Target("videos", "the Plenoptic layout as videos: cam00.mp4 … and poses_bounds.npy", example, changes, check)
