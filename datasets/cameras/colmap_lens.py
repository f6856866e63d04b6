"""COLMAP's lens models by its own tables and formulas, those of pycolmap: whatever the installed version knows.

pycolmap runs in processes of its own. It bundles copies of common C libraries, which replace those of packages loaded
later: after `import pycolmap` Pillow's first PNG ended in "corrupted size".
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
from dataclasses import dataclass
from functools import cache, lru_cache

import cv2
import numpy as np

from datasets.cameras.lens import Lens

OUTSIDE = -1e4  # pixels: where the formula has no value
LIST_MODELS = """
import json, pycolmap
kinds = [kind for kind in pycolmap.CameraModelId.__members__.values() if kind.name != "INVALID"]
print(json.dumps({int(kind): (kind.name, pycolmap.Camera(model=kind).params_info) for kind in kinds}))
"""
IMAGE_POINTS = """
import sys, numpy as np, pycolmap
model, *coefficients = sys.argv[1:]
points = np.frombuffer(sys.stdin.buffer.read()).reshape(-1, 2)
lens = pycolmap.Camera(model=model, width=1, height=1, params=[1, 1, 0, 0, *map(float, coefficients)])
found = lens.img_from_cam(np.column_stack([points, np.ones(len(points))]))
sys.stdout.buffer.write(np.ascontiguousarray(found, np.float64).tobytes())
"""


@dataclass(frozen=True)
class Model:
    """A lens model of COLMAP."""

    name: str
    parameters: tuple[str, ...]  # names, in the order of the files: the focal lengths, cx, cy, then the coefficients

    @property
    def focal_lengths(self) -> int:
        """1 or 2; 0: it images no plane, as a panorama."""
        return sum(name in ("f", "fx", "fy") for name in self.parameters)


@cache
def models() -> dict[int, Model]:
    """By their numbers in binary files."""
    listed = json.loads(_ask(LIST_MODELS)).items()
    return {int(number): Model(name, tuple(re.split(r"[,\s]+", info))) for number, (name, info) in listed}


@dataclass(frozen=True)
class ColmapLens(Lens):
    """A lens of any model with two focal lengths."""

    model: str = "PINHOLE"

    @property
    def names(self) -> tuple[str, ...]:
        return next(model.parameters[4:] for model in models().values() if model.name == self.model)

    @lru_cache(maxsize=32)  # noqa: B019 (the frames of a camera share theirs)
    def maps(self, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
        return super().maps(size)

    def _maps(self, matrix: np.ndarray, bent: np.ndarray, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
        column, row = np.meshgrid(*((np.arange(side) - middle) for side, middle in zip(size, matrix[:2, 2])))
        x, y = self._bent(column / self.fx, row / self.fy)
        pixels = np.stack([x * self.fx + matrix[0, 2], y * self.fy + matrix[1, 2]]).astype(np.float32)
        sources = np.nan_to_num(pixels, nan=OUTSIDE)
        return cv2.convertMaps(sources[0], sources[1], cv2.CV_16SC2)  # type: ignore[return-value]

    def _bent(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        points = np.stack([x, y], axis=-1).astype(np.float64)
        answer = _ask(IMAGE_POINTS, self.model, *map(repr, self.coefficients), data=points.tobytes())
        found = np.frombuffer(answer).reshape(points.shape)
        return found[..., 0], found[..., 1]


def _ask(script: str, *arguments: str, data: bytes = b"") -> bytes:
    """Standard output of a script in a Python of its own."""
    command = [sys.executable, "-P", "-c", script, *arguments]  # -P: whatever lies in the current folder
    done = subprocess.run(command, input=data, capture_output=True)
    if done.returncode:
        raise OSError(f"pycolmap: {done.stderr.decode(errors='replace').strip().splitlines()[-1]}")
    return done.stdout
