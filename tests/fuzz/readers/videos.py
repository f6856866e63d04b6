"""datasets/plenoptic/videos.py: the Plenoptic layout as videos with poses_bounds.npy, from file to frames."""

from __future__ import annotations

import subprocess
import tempfile
from pathlib import Path

import numpy as np
from hypothesis.strategies import SearchStrategy
from imageio_ffmpeg import get_ffmpeg_exe

from datasets.plenoptic import read_plenoptic
from fuzz.edits.arrays import edit_npy
from fuzz.edits.bytes import changed_files
from fuzz.readers.poses import NAMES, SIZE, poses_file
from fuzz.scene import require_scene
from fuzz.target import Changes, Files, Target, valid_or_refused

FRAMES = 3


def example() -> Files:
    return {"poses_bounds.npy": poses_file(), **{f"{name}.mp4": _video(number) for number, name in enumerate(NAMES)}}


def _video(seed: int) -> bytes:
    """H.264 of FRAMES frames, the index before them: what a change leaves can often be decoded."""
    width, height = SIZE
    pixels = np.random.default_rng(seed).integers(0, 256, (FRAMES, height // 8, width // 8, 3), dtype=np.uint8)
    pixels = pixels.repeat(8, axis=1).repeat(8, axis=2)
    with tempfile.TemporaryDirectory() as temporary:
        path = Path(temporary) / "video.mp4"
        subprocess.run(
            [
                get_ffmpeg_exe(),
                "-v",
                "error",
                "-f",
                "rawvideo",
                "-pix_fmt",
                "rgb24",
                "-s",
                f"{width}x{height}",
                "-r",
                "30",
                "-i",
                "-",
                "-c:v",
                "libx264",
                "-preset",
                "ultrafast",
                "-threads",
                "1",
                "-crf",
                "30",
                "-pix_fmt",
                "yuv420p",
                "-movflags",
                "+faststart",
                str(path),
            ],
            input=pixels.tobytes(),
            check=True,
        )
        return path.read_bytes()


def changes(files: Files) -> SearchStrategy[Changes]:
    return changed_files(files, {".npy": edit_npy})


def check(folder: Path) -> str:
    with valid_or_refused(folder) as outcome:
        require_scene(
            read_plenoptic(
                folder, name="fuzz/videos", downscale=2, cache=folder / "cache", threads=1, log=lambda text: None
            )
        )
    return outcome[0]


TARGET = Target("videos", "the Plenoptic layout as videos: cam00.mp4 … and poses_bounds.npy", example, changes, check)
