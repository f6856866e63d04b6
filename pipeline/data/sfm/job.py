"""The files by which a run and its COLMAP process talk, in a folder of their own.

    images/<name>.png, request.json     in
    found.npz, found.json               out, or
    error.txt                           one line

Both sides read this page, so it imports neither pycolmap nor Pillow.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np


@dataclass(frozen=True)
class Shot:
    """A photograph without its pixels."""

    name: str
    camera: dict | None  # {"intrinsics": [fx, fy, cx, cy], "world_to_cam": 4 x 4}; None: unknown
    held_out: bool


@dataclass(frozen=True)
class Request:
    """What to reconstruct and how; the settings are those of config.InitConfig."""

    photographs: list[Shot]
    unit: float  # world units, for distances
    seed: int
    max_features: int
    max_error_px: float
    min_track: int
    min_angle_deg: float
    max_distance: float
    refine_poses: bool
    shared_intrinsics: bool

    @property
    def poses_known(self) -> bool:
        return all(p.camera is not None for p in self.photographs)

    def camera_of(self, name: str) -> dict:
        return next(p.camera for p in self.photographs if p.name == name)


@dataclass(frozen=True)
class Found:
    """What COLMAP found; arrays as in photograph.Reconstruction, lenses as colmap.lens_of makes them."""

    points: np.ndarray
    colors: np.ndarray
    errors: np.ndarray
    track_lengths: np.ndarray
    lenses: dict[str, dict]


def write_request(folder: Path, request: Request) -> None:
    (folder / "request.json").write_text(json.dumps(asdict(request)))


def read_request(folder: Path) -> Request:
    content = json.loads((folder / "request.json").read_text())
    return Request(**{**content, "photographs": [Shot(**shot) for shot in content["photographs"]]})


def write_found(folder: Path, found: Found) -> None:
    np.savez(
        folder / "found.npz",
        points=found.points,
        colors=found.colors,
        errors=found.errors,
        track_lengths=found.track_lengths,
    )
    (folder / "found.json").write_text(json.dumps(found.lenses))


def read_found(folder: Path) -> Found:
    with np.load(folder / "found.npz") as arrays:
        return Found(**arrays, lenses=json.loads((folder / "found.json").read_text()))


def fail(folder: Path, line: str) -> None:
    (folder / "error.txt").write_text(line)


def failure(folder: Path) -> str | None:
    path = folder / "error.txt"
    return path.read_text() if path.exists() else None
