"""What the result of each stage depends on: its part of the configuration, the data, and the code that makes it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict
from functools import cache
from pathlib import Path

import numpy as np

from datasets.scene import Scene
from pipeline.config.schema import Config
from pipeline.data.prepare import Prepared

ROOT = Path(__file__).resolve().parents[2]
SOURCES = (".py", ".cpp", ".hpp", ".js", ".html", ".css", ".frag", ".vert", ".glsl")


def config_hash(cfg: Config, stage: str) -> str:
    """Of the keys that the result of a stage depends on. `scene` hardly counts: the data have a hash of their own."""
    tree = asdict(cfg)
    if stage == "prepare":
        return _hash(tree["init"])
    training = [tree[group] for group in ("init", "ablation", "train", "seed")]
    training += [tree["scene"]["near"], tree["scene"]["background_model"]]
    return _hash(*training, *([tree["evaluate"]] if stage in ("evaluate", "page") else []))


def data_hash(data: Prepared) -> str:
    """Of the scene, its coordinates and its initial points."""
    parts: list[object] = [fingerprint(data.scene), asdict(data.canonical)]
    if data.sfm_folder is not None:
        parts.append(data.sfm_folder.name)  # of the images and settings of structure from motion
    elif data.cloud is not None:
        parts.append(_digest(data.cloud.points, data.cloud.colors))
    return _hash(*parts)


def fingerprint(scene: Scene) -> str:
    """Hash of a scene's images, masks, cameras, sweeps, times and bounds. Its folder does not matter."""
    digest = hashlib.blake2b(digest_size=16)
    digest.update(repr((scene.duration, scene.time_start, scene.background, scene.init_box)).encode())
    for view in scene.train + scene.test:
        c = view.camera
        digest.update(repr((view.name, view.time, c.width, c.height, c.fx, c.fy, c.cx, c.cy)).encode())
        digest.update(c.world_to_cam.tobytes())
        # A stored frame knows its checksum: a scene of 25 GB need not be read for this.
        known = getattr(view.image, "checksum", None)
        digest.update(np.ascontiguousarray(view.image).data if known is None else known.encode())
        for plane in (view.coverage, view.mask):
            if plane is not None:
                digest.update(np.ascontiguousarray(plane).data)
        for mask in (view.sky, view.moving):
            if mask is not None:
                digest.update(np.packbits(mask).data)
    for sweep in scene.sweeps + scene.test_sweeps:
        digest.update(repr((sweep.frame, sweep.time)).encode())
        digest.update(np.ascontiguousarray(sweep.points).data)
    return digest.hexdigest()


def code_hash(rooms: Sequence[str]) -> str:
    """Of the source files of these rooms: files, or folders with all below them, relative to the checkout."""
    return _hash(*map(_room_hash, rooms))


@cache
def _room_hash(room: str) -> str:
    digest, path = hashlib.blake2b(digest_size=16), ROOT / room
    for file in sorted(path.rglob("*")) if path.is_dir() else [path]:
        if file.suffix in SOURCES:
            digest.update(file.relative_to(ROOT).as_posix().encode())
            digest.update(file.read_bytes())
    return digest.hexdigest()


def _digest(*arrays: np.ndarray) -> str:
    digest = hashlib.blake2b(digest_size=16)
    for array in arrays:
        digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()


def _hash(*parts: object) -> str:
    return hashlib.blake2b(json.dumps(parts, sort_keys=True, default=str).encode(), digest_size=16).hexdigest()
