"""Target datasets/readers/llff.py: images and poses_bounds.npy of one camera."""

from __future__ import annotations

from functools import partial

from layout_folders import write_llff

from fuzz.edits.arrays import edit_npy
from fuzz.layout_target import layout_target

TARGET = layout_target(
    "llff", "images of one moving camera with poses_bounds.npy", partial(write_llff, count=4), {".npy": edit_npy}
)
