"""Reader of COLMAP's folder: images/ and sparse/0 with cameras, images and points3D, binary or text.

    https://colmap.github.io/format.html
    DIR/images/…                              the photographs; images_2, images_4, … are ignored
    DIR/sparse/0/cameras.bin, images.bin, points3D.bin   or the same as .txt; also DIR/sparse, DIR/colmap/sparse/0
    DIR/dense/sparse, DIR/dense/images        what colmap image_undistorter writes

Lens models are undistorted, and those that OpenCV has no formula for are refused by name. Poses are world-to-camera
with COLMAP's axes, which are the project's.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from datasets.cameras.intrinsics import LARGEST_COEFFICIENT
from datasets.cameras.lens import FisheyeLens, Lens, Undistortion
from datasets.files.errors import SceneError
from datasets.files.image_files import is_file
from datasets.layouts.cameras_and_times import by_folder
from datasets.layouts.colmap_files import ImageRecord, LensRecord, read_cameras, read_images, read_points
from datasets.layouts.photograph import LayoutOptions, Photograph
from datasets.layouts.photographs import scene_points, to_scene
from datasets.scene import Scene, make_camera
from rasterizer.camera import Camera

LARGEST_TRACK_ERROR = 2.0  # pixels: points of a larger reprojection error are left out
FOLDERS = ("sparse/0", "sparse", "colmap/sparse/0", "colmap/sparse", "dense/sparse")
UNDISTORTED = (
    "SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV", "OPENCV_FISHEYE",
    "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE",
)  # fmt: skip


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
    suffix = "bin" if (folder / "images.bin").is_file() else "txt"
    file = folder / f"images.{suffix}"
    lenses = read_cameras(folder / f"cameras.{suffix}")
    photographs: list[Photograph] = []
    pictures = _image_folder(root, folder)
    for image in read_images(file):
        where = f"{file}: {image.name}"
        if image.camera not in lenses:
            raise SceneError(where, f"a camera among {', '.join(map(str, sorted(lenses)))}", f"{image.camera}")
        path = pictures / image.name
        if not is_file(path):
            raise SceneError(path, f"the image that {file} names", "no such file")
        camera, lens = _camera(lenses[image.camera], image, where)
        name = Path(image.name).with_suffix("").as_posix().replace("/", "_")
        photographs.append(Photograph(name, path, camera, lens))
    rows = read_points(folder)
    rows = rows[rows[:, 6] <= LARGEST_TRACK_ERROR]
    points = scene_points(rows[:, :3], rows[:, 3:6])
    models = ", ".join(sorted({lens.model for lens in lenses.values()}))
    count = len(points.positions) if points else 0
    options.log(f"COLMAP: {len(photographs)} images, {len(lenses)} lenses ({models}), {count} points")
    return to_scene(root, by_folder(photographs), options, points)


def _image_folder(root: Path, folder: Path) -> Path:
    """The folder that the model in `folder` names images of: images beside its sparse before others, as another
    reconstruction's have other lenses."""
    beside = next(parent.parent for parent in (folder, folder.parent) if parent.name == "sparse")
    candidates = (place / name for place in (beside, root) for name in ("images", "input"))
    return next((candidate for candidate in candidates if candidate.is_dir()), root)


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
    if not all(abs(value) <= LARGEST_COEFFICIENT for value in bent):
        raise SceneError(where, f"a lens distortion within ±{LARGEST_COEFFICIENT:g}", f"{model} {bent}")
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation_of(image.quaternion, where), image.translation
    camera = make_camera(where, lambda: Camera(lens.width, lens.height, fx, fy, cx, cy, pose))
    if "FISHEYE" in model:  # with coefficients of 0 it is equidistant, not straight
        return camera, FisheyeLens(fx, fy, cx, cy, bent + (0.0,) * (4 - len(bent)))
    return camera, Undistortion.of(camera, *bent) if any(bent) else None


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
