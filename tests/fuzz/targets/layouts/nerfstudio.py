"""Target datasets/readers/nerfstudio.py: transforms.json, masks and a .ply."""

from __future__ import annotations

from functools import partial

from layout_folders import write_nerfstudio

from fuzz.edits.bytes import edit_text
from fuzz.edits.json import edit_json
from fuzz.layout_target import layout_target

TARGET = layout_target(
    "nerfstudio", "nerfstudio's folder", partial(write_nerfstudio, count=4), {".json": edit_json, ".ply": edit_text}
)
