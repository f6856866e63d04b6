"""All targets by name. A target's module is imported only when it is asked for: each needs packages of its own."""

from __future__ import annotations

import importlib

from fuzz.target import Target

MODULES = {
    "dnerf": "readers.dnerf",
    "images": "readers.images",
    "videos": "readers.videos",
    "poses": "readers.poses",
    "frames": "readers.frames",
    "checkpoint": "readers.checkpoint",
    "ply": "readers.ply",
    "sfm": "readers.sfm",
    "photographs": "readers.photographs",
    "report": "readers.report",
    "run": "readers.run",
    "rasterize": "render",
}


def target_of(name: str) -> Target:
    return importlib.import_module(f"fuzz.{MODULES[name]}").TARGET
