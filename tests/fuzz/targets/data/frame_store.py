"""Target datasets/files/frame_store.py: decoded frames in the cache."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from hypothesis.strategies import SearchStrategy

from datasets.files.frame_store import read_frames, write_frames
from fuzz.edits.arrays import edit_npy
from fuzz.edits.bytes import changed_files
from fuzz.edits.json import edit_json
from fuzz.target import REFUSED, Changes, Files, Target, read_files, require, valid_or_refused

SHAPE = (3, 4, 5, 3)  # frames, H, W, RGB
IMAGES = np.random.default_rng(0).integers(0, 256, SHAPE, dtype=np.uint8)


def example() -> Files:
    with tempfile.TemporaryDirectory() as temporary:
        write_frames(Path(temporary), "cam00", SHAPE, iter(IMAGES), {"source": "cam00.mp4"})
        return read_files(Path(temporary))


def changes(files: Files) -> SearchStrategy[Changes]:
    return changed_files(files, {".json": edit_json, ".npy": edit_npy})


def check(folder: Path) -> str:
    """The frames are those written, or None, which makes the caller decode again."""
    with valid_or_refused(folder) as outcome:
        frames = read_frames(folder, "cam00", SHAPE)
        if frames is None:
            return REFUSED
        for frame in frames:
            image = np.asarray(frame)
            require(any(np.array_equal(image, written) for written in IMAGES), "pixels that were not written")
            require(isinstance(frame.checksum, str), f"a checksum {frame.checksum!r}")
    return outcome[0]


TARGET = Target("frame_store", "the store of decoded frames: <camera>.npy and .json", example, changes, check)
