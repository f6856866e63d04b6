"""Files of a COLMAP job, by which the run (run.py) and the COLMAP process (colmap.py) communicate.

    images/<image_file>, request.json   input
    result.npz, result.json             output, or
    error.json                          an SfmError

Both processes import this module, so it imports neither pycolmap nor Pillow (see colmap.py).
"""

from __future__ import annotations

import json
import re
from dataclasses import asdict, dataclass
from pathlib import Path
from urllib.parse import unquote

import numpy as np

SEED = 0  # COLMAP's, apart from the run's: runs of several seeds share its result
# Advice where too few frames of a clip are registered.
WHAT_TO_OVERLAP = (
    "film slowly, with texture in view all the time, and so that every part of the scene is seen from several places"
)
WHAT_TO_DRIVE = (
    "a car's video needs many frames a second, little speed, images at full size and no bonnet or dashboard in them; "
    "with its poses or LiDAR it is a driving log (scene=kitti, scene=waymo)"
)
ARRAYS = ("points", "colors", "errors", "track_lengths", "observations")  # of a result; the last may be None


def image_file(name: str) -> str:
    """The file of photograph `name` in the folder of images, and its name in COLMAP.

    In its lists of pairs COLMAP splits at spaces and skips lines that begin with #.
    """
    return re.sub(r"[\s%#]", lambda found: "".join(f"%{byte:02X}" for byte in found[0].encode()), name) + ".png"


def photograph_name(file: str) -> str:
    """The name of the photograph with this image_file."""
    return unquote(file.removesuffix(".png"))


class SfmError(ValueError):
    """The photographs do not suffice for the reconstruction. camera_turns: because the camera only turned."""

    def __init__(self, line: str, camera_turns: bool = False) -> None:
        super().__init__(line)
        self.camera_turns = camera_turns


@dataclass(frozen=True)
class PhotographRecord:
    """A photograph without its pixels."""

    name: str
    camera: dict | None  # {"intrinsics": [fx, fy, cx, cy], "world_to_cam": 4 x 4}; None: unknown
    held_out: bool


@dataclass(frozen=True)
class Request:
    """The photographs and the settings, which are those of InitConfig."""

    photographs: list[PhotographRecord]
    unit: float  # world units per normalised unit
    max_features: int
    refine_poses: bool
    shared_intrinsics: bool
    pairs: list[list[str]] | None = None  # names of photographs to match; None: all with all
    least_registered: float = 1.0  # share of the photographs whose pose must be found
    masked: bool = False  # a second pass: the job folder has features and matches, and masks of what moves
    lenses: list[list[str]] | None = None  # photographs that share a lens; None: as shared_intrinsics says
    intrinsics: dict[str, list[float]] | None = None  # photograph -> initial [focal, cx, cy, k] of its lens
    observations: bool = False  # whether the result says which photograph sees which point where

    @property
    def poses_known(self) -> bool:
        return all(p.camera is not None for p in self.photographs)

    def camera_of(self, name: str) -> dict:
        """The known camera of photograph `name`."""
        return next(p.camera for p in self.photographs if p.name == name and p.camera is not None)


@dataclass(frozen=True)
class ColmapResult:
    """COLMAP's result: arrays as in photograph.Reconstruction, cameras as of features.camera_record, by name."""

    points: np.ndarray
    colors: np.ndarray
    errors: np.ndarray
    track_lengths: np.ndarray
    cameras: dict[str, dict]
    observations: np.ndarray | None = None
    drives: bool = False  # of a clip: whether the camera moves along its axis, as a car's


def write_request(folder: Path, request: Request) -> None:
    (folder / "request.json").write_text(json.dumps(asdict(request)))


def read_request(folder: Path) -> Request:
    content = json.loads((folder / "request.json").read_text())
    return Request(**{**content, "photographs": [PhotographRecord(**record) for record in content["photographs"]]})


def write_result(folder: Path, result: ColmapResult) -> None:
    arrays = {name: getattr(result, name) for name in ARRAYS}
    np.savez(folder / "result.npz", **{name: array for name, array in arrays.items() if array is not None})
    (folder / "result.json").write_text(json.dumps({"cameras": result.cameras, "drives": result.drives}))


def read_result(folder: Path) -> ColmapResult:
    with np.load(folder / "result.npz") as arrays:
        return ColmapResult(**arrays, **json.loads((folder / "result.json").read_text()))


def write_error(folder: Path, error: SfmError) -> None:
    (folder / "error.json").write_text(json.dumps({"line": str(error), "camera_turns": error.camera_turns}))


def read_error(folder: Path) -> SfmError | None:
    path = folder / "error.json"
    return SfmError(**json.loads(path.read_text())) if path.exists() else None
