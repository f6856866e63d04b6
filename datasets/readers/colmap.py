"""Reader of COLMAP's folder: images/ and sparse/0 with cameras, images and points3D, binary or text.

    https://colmap.github.io/format.html
    DIR/images/…                              the photographs; images_2, images_4, … are ignored
    DIR/sparse/0/cameras.bin, images.bin, points3D.bin   or the same as .txt; also DIR/sparse, DIR/colmap/sparse/0
    DIR/dense/sparse, DIR/dense/images        what colmap image_undistorter writes

Lens models are undistorted; panoramas are refused by name. A camera that no image uses may be invalid. Poses are
world-to-camera with COLMAP's axes, which are the project's.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from datasets.cameras.colmap_lens import ColmapLens, models
from datasets.cameras.intrinsics import LARGEST_COEFFICIENT
from datasets.cameras.lens import FisheyeLens, Lens, Undistortion
from datasets.files.colmap_files import ImageRecord, LensRecord, read_cameras, read_images, read_points
from datasets.files.errors import SceneError, clear
from datasets.files.image_files import is_file
from datasets.files.named_files import named_path, say_renamed
from datasets.photographs.file_names import by_name
from datasets.photographs.photograph import PosedFile
from datasets.photographs.points import scene_points
from datasets.photographs.scene import to_scene
from datasets.scene import Scene, ScenePoints, make_camera
from datasets.settings import SceneConfig
from datasets.source import Log
from rasterizer.camera import Camera

# Points of a larger reprojection error are left out: pixels, and of the longer side of larger images.
LARGEST_ERROR, LARGEST_RELATIVE_ERROR = 2.0, 1e-3
FOLDERS = ("sparse", "colmap/sparse", "dense/sparse")  # of a model, or of several in folders 0, 1, …
# Models that are OpenCV's, with fewer coefficients or all; pycolmap's formulas are for the others.
OPENCV = ("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV")
FISHEYE = ("SIMPLE_FISHEYE", "FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "OPENCV_FISHEYE")
TITLE, PRECEDENCE = "COLMAP", 60


def matches(path: Path) -> str | None:
    return None if sparse_folders(path) else "no sparse/0 with images.bin or images.txt"


def sparse_folders(root: Path) -> list[Path]:
    """The folders of the models of one reconstruction: the mapper writes one for each part that it could not join."""
    for name in FOLDERS:
        numbered = sorted((p for p in root.glob(f"{name}/*") if p.name.isdecimal()), key=lambda p: int(p.name))
        if found := [folder for folder in (*numbered, root / name) if _images_file(folder) is not None]:
            return found
    return []


def _images_file(folder: Path) -> Path | None:
    return next((file for suffix in ("bin", "txt") if (file := folder / f"images.{suffix}").is_file()), None)


def read(root: Path, cfg: SceneConfig, log: Log) -> Scene:
    """The scene; images without a pose are left out. SceneError for invalid files and lens models that are unknown."""
    folders = sparse_folders(root)
    if not folders:
        raise SceneError(root, "sparse/0 with images.bin or images.txt", "neither")
    parts = {path: read_images(path) for folder in folders if (path := _images_file(folder)) is not None}
    file = max(parts, key=lambda path: len(parts[path]))  # the first of equals
    folder, suffix = file.parent, file.suffix[1:]
    if len(parts) > 1:
        sizes = ", ".join(f"{path.parent.name} has {len(images)}" for path, images in parts.items())
        log(f"COLMAP: {len(parts)} models ({sizes} images); the largest is used, {folder}")
    cameras = folder / f"cameras.{suffix}"
    lenses = read_cameras(cameras)
    used = {image.camera for image in parts[file]}
    photographs: list[PosedFile] = []
    pictures = _image_folder(root, folder)
    for image in parts[file]:
        where = f"{file}: {image.name}"
        if image.camera not in lenses:
            raise SceneError(where, f"a camera among {', '.join(map(str, sorted(lenses)))}", f"{image.camera}")
        path = named_path(pictures, image.name)
        if not is_file(path):
            raise SceneError(path, f"the image that {file} names", "no such file")
        camera, lens = _camera(lenses[image.camera], image, where, f"{cameras}: camera {image.camera}")
        name = path.relative_to(pictures).with_suffix("").as_posix().replace("/", "_")
        photographs.append(PosedFile(name, path, camera, lens))
    say_renamed(file, (pictures / image.name for image in parts[file]), (p.path for p in photographs), log)
    points = _points(folder, max(max(lenses[n].width, lenses[n].height) for n in used), log)
    if unused := sorted(set(lenses) - used):
        log(f"{cameras.name}: left out, as no image is by them: {clear(', '.join(f'camera {n}' for n in unused))}")
    kinds = ", ".join(sorted({lenses[number].model for number in used}))
    count = len(points.positions) if points else 0
    log(f"COLMAP: {len(photographs)} images, {len(used)} lenses ({kinds}), {count} points")
    return to_scene(root, by_name(root, photographs, log), cfg, log, points)


def _points(folder: Path, side: int, log: Log) -> ScenePoints | None:
    """Those of small reprojection error. side: the longer one of the images, pixels."""
    rows, bound = read_points(folder), max(LARGEST_ERROR, LARGEST_RELATIVE_ERROR * side)
    near = rows[:, 6] <= bound  # -1: unknown
    if not near.all():
        log(f"points: {np.count_nonzero(~near)} of {len(rows)} have a reprojection error above {bound:g} px: left out")
    colors = rows[near, 3:6]
    whole = not (colors % 1).any()  # a script may write fractions
    return scene_points(rows[near, :3], colors.astype(np.int64) if whole else colors, log)


def _image_folder(root: Path, folder: Path) -> Path:
    """The folder that the model in `folder` names images of: images beside its sparse before others, as another
    reconstruction's have other lenses."""
    beside = next(parent.parent for parent in (folder, folder.parent) if parent.name == "sparse")
    candidates = (place / name for place in (beside, root) for name in ("images", "input"))
    return next((candidate for candidate in candidates if candidate.is_dir()), root)


def _camera(lens: LensRecord, image: ImageRecord, where: str, of_lens: str) -> tuple[Camera, Lens | None]:
    model = next((model for model in models().values() if model.name == lens.model), None)
    known = ", ".join(model.name for model in models().values() if model.focal_lengths)
    if model is None or not model.focal_lengths:
        way = (
            "cut panoramas into pinholes first (panorama_sfm.py of pycolmap)"
            if model
            else "a newer pycolmap may know it"
        )
        raise SceneError(of_lens, f"a lens model among {known}", f"{lens.model}; {way}")
    p, count = lens.parameters, len(model.parameters)
    if len(p) != count:
        raise SceneError(of_lens, f"{lens.model} with {count} parameters, {', '.join(model.parameters)}", f"{len(p)}")
    fx, fy, cx, cy = (p[0], *p[:3]) if model.focal_lengths == 1 else p[:4]
    bent = p[model.focal_lengths + 2 :]
    if not all(abs(value) <= LARGEST_COEFFICIENT for value in bent):
        raise SceneError(of_lens, f"a lens distortion within ±{LARGEST_COEFFICIENT:g}", f"{lens.model} {bent}")
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation_of(image.quaternion, where), image.translation
    camera = make_camera(where, lambda: Camera(lens.width, lens.height, fx, fy, cx, cy, pose))
    if lens.model in FISHEYE:  # with coefficients of 0 it is equidistant, not straight
        return camera, FisheyeLens(fx, fy, cx, cy, bent + (0.0,) * (4 - len(bent)))
    if lens.model not in OPENCV:
        return camera, ColmapLens(fx, fy, cx, cy, bent, lens.model.replace("SIMPLE_", ""))
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
