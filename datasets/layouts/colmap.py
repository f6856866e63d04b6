"""Reader of COLMAP's folder: images/ and sparse/0 with cameras, images and points3D, binary or text.

    https://colmap.github.io/format.html
    DIR/images/…                              the photographs; images_2, images_4, … are ignored
    DIR/sparse/0/cameras.bin, images.bin, points3D.bin   or the same as .txt; also DIR/sparse, DIR/colmap/sparse/0

Lens models are undistorted, and those that OpenCV has no formula for are refused by name. Poses are world-to-camera
with COLMAP's axes, which are the project's.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from datasets.cameras.lens import FisheyeLens, Lens, Undistortion
from datasets.files.errors import SceneError
from datasets.layouts.photographs import LayoutOptions, Photograph, to_scene
from datasets.scene import Scene, ScenePoints, make_camera
from rasterizer.camera import Camera

FOLDERS = ("sparse/0", "sparse", "colmap/sparse/0", "colmap/sparse", "dense/sparse")
# COLMAP's id → (name, number of parameters).
MODELS = {
    0: ("SIMPLE_PINHOLE", 3), 1: ("PINHOLE", 4), 2: ("SIMPLE_RADIAL", 4), 3: ("RADIAL", 5), 4: ("OPENCV", 8),
    5: ("OPENCV_FISHEYE", 8), 6: ("FULL_OPENCV", 12), 7: ("FOV", 5), 8: ("SIMPLE_RADIAL_FISHEYE", 4),
    9: ("RADIAL_FISHEYE", 5), 10: ("THIN_PRISM_FISHEYE", 12), 11: ("RAD_TAN_THIN_PRISM_FISHEYE", 16),
}  # fmt: skip
UNDISTORTED = (
    "SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV", "OPENCV_FISHEYE",
    "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE",
)  # fmt: skip
LARGEST_TRACK_ERROR = 2.0  # pixels: points of a larger reprojection error are left out
MOST = 50_000_000  # images or points that a file may claim


@dataclass(frozen=True)
class LensRecord:
    """A camera of COLMAP: its lens, shared by images."""

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


def sparse_folder(root: Path) -> Path | None:
    """The folder of the model, None without one."""
    for name in FOLDERS:
        if any((root / name / f"images.{suffix}").is_file() for suffix in ("bin", "txt")):
            return root / name
    return None


def read_colmap(root: Path, options: LayoutOptions) -> Scene:
    """The scene; images without a pose are left out. SceneError for invalid files and lens models that are unknown."""
    folder = sparse_folder(root)
    if folder is None:
        raise SceneError(root, "sparse/0 with images.bin or images.txt", "neither")
    binary = (folder / "images.bin").is_file()
    lenses = _read_cameras(folder / ("cameras.bin" if binary else "cameras.txt"), binary)
    images = _read_images(folder / ("images.bin" if binary else "images.txt"), binary)
    photographs: list[Photograph] = []
    groups: dict[str, int] = {}  # images/left/1.png, images/right/1.png: a camera each
    pictures = next((root / name for name in ("images", "input") if (root / name).is_dir()), root)
    for image in images:
        where = f"{folder / 'images'}: {image.name}"
        if image.camera not in lenses:
            raise SceneError(where, f"a camera among {', '.join(map(str, sorted(lenses)))}", f"{image.camera}")
        path = pictures / image.name
        if not path.is_file():
            raise SceneError(path, f"the image that {folder.name} names", "no such file")
        camera, lens = _camera(lenses[image.camera], image, where)
        parent = Path(image.name).parent.as_posix()
        group = groups.setdefault(parent, len(groups))
        name = Path(image.name).with_suffix("").as_posix().replace("/", "_")
        photographs.append(Photograph(name, path, camera, lens, group=group))
    points = _read_points(folder)
    models = ", ".join(sorted({lens.model for lens in lenses.values()}))
    count = len(points.positions) if points else 0
    options.log(f"COLMAP: {len(photographs)} images, {len(lenses)} lenses ({models}), {count} points")
    return to_scene(root, photographs, options, points)


def _camera(lens: LensRecord, image: ImageRecord, where: str) -> tuple[Camera, Lens | None]:
    model, p = lens.model, lens.parameters
    if model not in UNDISTORTED:
        raise SceneError(
            where,
            f"a lens model among {', '.join(UNDISTORTED)}",
            f"{model}; colmap image_undistorter turns it into PINHOLE",
        )
    one_focal = model.startswith("SIMPLE") or model in ("RADIAL", "RADIAL_FISHEYE")
    fx, fy, cx, cy = (p[0], p[0], p[1], p[2]) if one_focal else p[:4]
    bent = p[3:] if one_focal else p[4:]
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation_of(image.quaternion, where), image.translation
    camera = make_camera(where, lambda: Camera(lens.width, lens.height, fx, fy, cx, cy, pose))
    if not any(bent):
        return camera, None
    if "FISHEYE" in model:
        return camera, FisheyeLens(fx, fy, cx, cy, bent + (0.0,) * (4 - len(bent)))
    return camera, Undistortion.of(camera, *bent)


def rotation_of(quaternion: np.ndarray, where: str) -> np.ndarray:
    """(3, 3) of w, x, y, z; SceneError unless it is a finite, nonzero quaternion."""
    length = float(np.linalg.norm(quaternion))
    if not 1e-6 < length < 1e6:
        raise SceneError(where, "a rotation quaternion", f"{quaternion.tolist()}")
    w, x, y, z = quaternion / length
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip


def _read_cameras(path: Path, binary: bool) -> dict[int, LensRecord]:
    found = {}
    if binary:
        with _opened(path) as file:
            for _ in range(_count(file, path)):
                number, model, width, height = _unpack(file, "<iiQQ", path)
                if model not in MODELS:
                    raise SceneError(path, f"lens models 0 to {max(MODELS)}", f"{model}")
                name, count = MODELS[model]
                found[number] = LensRecord(name, width, height, _unpack(file, f"<{count}d", path))
        return found
    for line in _lines(path):
        number, name, width, height, *parameters = line.split()
        found[int(number)] = LensRecord(name, int(width), int(height), tuple(map(float, parameters)))
    return found


def _read_images(path: Path, binary: bool) -> list[ImageRecord]:
    found = []
    if binary:
        with _opened(path) as file:
            for _ in range(_count(file, path)):
                values = _unpack(file, "<i7di", path)
                name = bytearray()
                while (char := file.read(1)) not in (b"\0", b""):
                    name += char
                (points,) = _unpack(file, "<Q", path)
                file.seek(24 * points, 1)
                found.append(_image(name.decode(errors="replace"), values[8], values[1:5], values[5:8]))
    else:
        # Two lines an image; the second, its points, may be empty.
        lines = [line for line in _text(path).splitlines() if not line.startswith("#")]
        for line in lines[0::2]:
            if line.strip():
                parts = line.split(maxsplit=9)
                numbers = [float(part) for part in parts[1:8]]
                found.append(_image(parts[9], int(parts[8]), numbers[:4], numbers[4:]))
    if not found:
        raise SceneError(path, "at least one image with a pose", "none")
    return found


def _image(name: str, camera: int, quaternion: object, translation: object) -> ImageRecord:
    return ImageRecord(name, int(camera), np.array(quaternion, float), np.array(translation, float))


def _read_points(folder: Path) -> ScenePoints | None:
    rows = []
    if (folder / "points3D.bin").is_file():
        path = folder / "points3D.bin"
        with _opened(path) as file:
            for _ in range(_count(file, path)):
                values = _unpack(file, "<QdddBBBdQ", path)
                file.seek(8 * values[8], 1)
                rows.append((*values[1:4], *values[4:7], values[7]))
    elif (folder / "points3D.txt").is_file():
        for line in _lines(folder / "points3D.txt"):
            rows.append(tuple(float(part) for part in line.split()[1:8]))
    if not rows:
        return None
    table = np.array(rows, dtype=np.float64)
    good = np.isfinite(table).all(axis=1) & (table[:, 6] <= LARGEST_TRACK_ERROR)
    return ScenePoints(table[good, :3], table[good, 3:6].astype(np.uint8)) if good.any() else None


def _opened(path: Path) -> BinaryIO:
    try:
        return open(path, "rb")
    except OSError as error:
        raise SceneError(path, "a readable file", str(error)) from None


def _count(file: BinaryIO, path: Path) -> int:
    (count,) = _unpack(file, "<Q", path)
    if count > MOST:
        raise SceneError(path, f"at most {MOST} entries", f"{count}: damaged?")
    return int(count)


def _unpack(file: BinaryIO, layout: str, path: Path) -> tuple:
    content = file.read(struct.calcsize(layout))
    if len(content) < struct.calcsize(layout):
        raise SceneError(path, "a whole file of COLMAP", "one that ends early")
    return struct.unpack(layout, content)


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise SceneError(path, "a text file of COLMAP", str(error)) from None


def _lines(path: Path) -> Iterator[str]:
    yield from (line for line in _text(path).splitlines() if line.strip() and not line.startswith("#"))
