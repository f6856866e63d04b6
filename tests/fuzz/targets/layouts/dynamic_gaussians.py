"""Target datasets/readers/dynamic_gaussians.py: train_meta.json and init_pt_cld.npz."""

from __future__ import annotations

from functools import partial

from layout_folders import write_dynamic_gaussians

from fuzz.edits.arrays import edit_npz
from fuzz.edits.json import edit_json
from fuzz.layout_target import layout_target

TARGET = layout_target(
    "dynamic_gaussians",
    "the folder of Dynamic 3D Gaussians",
    partial(write_dynamic_gaussians, times=2),
    {".json": edit_json, ".npz": edit_npz},
)
