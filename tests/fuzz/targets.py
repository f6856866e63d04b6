"""All targets by name. A target's module is imported only when it is asked for: each needs packages of its own."""

from __future__ import annotations

import importlib

from fuzz.target import Target

MODULES = {
    "dnerf": "read_dnerf",
    "images": "read_images",
    "videos": "read_videos",
    "poses": "read_poses",
    "frames": "read_frames",
    "checkpoint": "read_checkpoint",
    "ply": "read_ply",
    "sfm": "read_sfm",
    "photographs": "read_photographs",
    "report": "read_report",
    "run": "read_run",
    "rasterize": "render",
}


def target_of(name: str) -> Target:
    return importlib.import_module(f"fuzz.{MODULES[name]}").TARGET
