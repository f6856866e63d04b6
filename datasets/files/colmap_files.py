"""The files of a model of COLMAP: cameras, images and points3D, each binary or text.

https://colmap.github.io/format.html
"""

from __future__ import annotations

import math
import os
import re
import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, TypeVar

import numpy as np

from datasets.cameras.colmap_lens import models
from datasets.files.errors import SceneError

MOST = 50_000_000  # images or points that a file may claim
COUNT = re.compile(r"^# Number of \w+: (\d{1,9})\b", re.MULTILINE)  # at the head of a text file
POINT_COLUMNS = 7  # x, y, z, red, green, blue, reprojection error in pixels

Parsed = TypeVar("Parsed")


@dataclass(frozen=True)
class LensRecord:
    """A camera of COLMAP: its lens, shared by images. As the file has it: only those of images are looked at."""

    model: str
    width: int
    height: int
    parameters: tuple[float, ...]


@dataclass(frozen=True)
class ImageRecord:
    """An image of COLMAP."""

    name: str
    camera: int
    quaternion: np.ndarray  # (4,) w, x, y, z of world-to-camera
    translation: np.ndarray  # (3,)


def read_cameras(path: Path) -> dict[int, LensRecord]:
    """Lenses by their number, of a .bin or .txt file."""
    return dict(_entries(path, _binary_camera, _text_camera))


def read_images(path: Path) -> list[ImageRecord]:
    """The images that have a pose, one at least."""
    found = _entries(path, _binary_image, _text_image, _is_points_of_image)
    if not found:
        raise SceneError(path, "at least one image with a pose", "none")
    return found


def read_points(folder: Path) -> np.ndarray:
    """(N, POINT_COLUMNS) float64; N = 0 without a file of points."""
    files = [folder / f"points3D.{suffix}" for suffix in ("bin", "txt")]
    path = next((file for file in files if file.is_file()), None)
    rows = _entries(path, _binary_point, _text_point) if path else []
    return np.array(rows, dtype=np.float64).reshape(-1, POINT_COLUMNS)


def _entries(
    path: Path,
    binary: Callable[[_Binary], Parsed],
    text: Callable[[str], Parsed],
    is_second: Callable[[str], bool] = lambda line: False,
) -> list[Parsed]:
    """The entries of a file; is_second: whether a line of a text file is the second one of the entry before it, which
    scripts leave out.

    Between the entries of a text file empty lines and comments are skipped. SceneError for fewer entries than the
    comment at its head counts, as of a file that was cut.
    """
    try:
        if path.suffix == ".bin":
            with open(path, "rb") as opened:
                file = _Binary(path, opened)
                return [binary(file) for _ in range(file.count())]
        content = path.read_text(encoding="utf-8-sig")  # with or without a byte-order mark
    except (OSError, UnicodeDecodeError) as error:
        raise SceneError(path, "a file of COLMAP", str(error)) from None
    found: list[Parsed] = []
    second = False  # whether the next line may be one
    for line in content.splitlines():
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        if second and is_second(line):
            second = False
            continue
        try:
            found.append(text(line))
        except (ValueError, IndexError):
            raise SceneError(f"{path}: {line!r}", "a line as COLMAP writes it", "something else") from None
        second = True
    if (stated := COUNT.search(content)) and len(found) < int(stated[1]):
        expected = f"{stated[1]} entries, as its comment says (correct it if they were left out on purpose)"
        raise SceneError(path, expected, f"{len(found)}")
    return found


def _is_points_of_image(line: str) -> bool:
    """Whether it is x, y, number of each point; a line of an image ends with a name."""
    parts = line.split()
    return len(parts) % 3 == 0 and _is_number(parts[-1])


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


@dataclass(frozen=True)
class _Binary:
    """A binary file. Every read refuses one that ends early."""

    path: Path
    file: BinaryIO

    def unpack(self, layout: str) -> tuple:
        content = self.file.read(struct.calcsize(layout))
        if len(content) < struct.calcsize(layout):
            raise self._early()
        return struct.unpack(layout, content)

    def count(self) -> int:
        (count,) = self.unpack("<Q")
        if count > MOST:
            raise SceneError(self.path, f"at most {MOST} entries", f"{count}: damaged?")
        return int(count)

    def skip(self, size: int) -> None:
        if size > os.fstat(self.file.fileno()).st_size - self.file.tell():
            raise self._early()
        self.file.seek(size, 1)

    def text(self) -> str:
        content = bytearray()
        while (char := self.file.read(1)) != b"\0":
            if not char:
                raise self._early()
            content += char
        return content.decode(errors="replace")

    def _early(self) -> SceneError:
        return SceneError(self.path, "a whole file of COLMAP", "one that ends early")


def _binary_camera(file: _Binary) -> tuple[int, LensRecord]:
    number, kind, width, height = file.unpack("<iiQQ")
    if (model := models().get(kind)) is None:  # without the number of its parameters the file ends here
        known = f"lens models 0 to {max(models())}, as pycolmap knows them"
        raise SceneError(f"{file.path}: camera {number}", known, f"{kind}; a newer pycolmap may know it")
    return number, LensRecord(model.name, width, height, file.unpack(f"<{len(model.parameters)}d"))


def _text_camera(line: str) -> tuple[int, LensRecord]:
    number, name, width, height, *parameters = line.split()
    return int(number), LensRecord(name, int(width), int(height), tuple(map(_real, parameters)))


def _real(word: str) -> float:
    """A number; NaN also as Windows' programs write it, -nan(ind) or 1.#QNAN."""
    return math.nan if re.fullmatch(r"[-+]?(nan\(\w*\)|1\.#\w+)", word, re.IGNORECASE) else float(word)


def _binary_image(file: _Binary) -> ImageRecord:
    values = file.unpack("<i7di")
    name = file.text()
    (points,) = file.unpack("<Q")
    file.skip(24 * points)
    return ImageRecord(name, values[8], np.array(values[1:5]), np.array(values[5:8]))


def _text_image(line: str) -> ImageRecord:
    parts = line.strip().split(maxsplit=9)
    numbers = np.array([_real(part) for part in parts[1:8]])
    return ImageRecord(parts[9], int(parts[8]), numbers[:4], numbers[4:])


def _binary_point(file: _Binary) -> tuple[float, ...]:
    values = file.unpack("<QdddBBBdQ")
    file.skip(8 * values[8])
    return values[1:8]


def _text_point(line: str) -> tuple[float, ...]:
    values = tuple(_real(part) for part in line.split()[1 : 1 + POINT_COLUMNS])
    if len(values) != POINT_COLUMNS:
        raise ValueError
    return values
