"""Target datasets/readers/nerfies.py: dataset.json, metadata.json, a camera file for each image, points.npy."""

from __future__ import annotations

from functools import partial

from layout_folders import write_nerfies

from fuzz.edits.arrays import edit_npy
from fuzz.edits.json import edit_json
from fuzz.layout_target import layout_target

TARGET = layout_target(
    "nerfies",
    "the folder of Nerfies, HyperNeRF and DyCheck",
    partial(write_nerfies, count=4),
    {".json": edit_json, ".npy": edit_npy},
)
