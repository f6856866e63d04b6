"""Reader of nerfstudio's folder: transforms.json and images, as ns-process-data writes them.

    {"camera_model": "OPENCV", "fl_x", "fl_y", "cx", "cy", "w", "h", "k1", "k2", "p1", "p2": shared or of each frame,
     "ply_file_path": "sparse_pc.ply", "applied_transform": 3×4, of the points and the poses alike,
     "train_filenames", "val_filenames", "test_filenames": optional,
     "frames": [{"file_path", "transform_matrix": 4×4 camera-to-world, "mask_path", "time": optional}, …]}

Poses have OpenGL's camera axes. Masks are black where pixels do not count.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from datasets.cameras.intrinsics import read_distortion, read_pinhole
from datasets.cameras.lens import FisheyeLens, Lens, Undistortion
from datasets.cameras.transforms import TransformsEntry, read_transforms
from datasets.files.errors import SceneError, read_json
from datasets.files.image_files import common_size, is_file
from datasets.files.json_values import read_number
from datasets.layouts.photographs import LayoutOptions, Photograph, scene_points, to_scene
from datasets.scene import Scene, ScenePoints
from rasterizer.camera import Camera

FISHEYE = ("OPENCV_FISHEYE", "FISHEYE")
COLORS = ("red", "green", "blue")


def read_nerfstudio(root: Path, options: LayoutOptions) -> Scene:
    """The scene. SceneError for invalid data and for cameras that are no perspective or fisheye lens."""
    file = root / "transforms.json"
    entries = read_transforms(file, root)
    content = read_json(file, SceneError)
    test = {name for key in ("val_filenames", "test_filenames") for name in _names(content, key, file)}
    size = common_size([entry.image_path for entry in entries])
    groups: dict[Path, int] = {}  # images/left/1.png, images/right/1.png: a camera each
    photographs = [
        _photograph(root, entry, size, test, groups.setdefault(entry.image_path.parent, len(groups)))
        for entry in entries
    ]
    repeated = {p.name for p in photographs}
    if len(repeated) < len(photographs):  # images/left/1.png and images/right/1.png
        photographs = [replace(p, name=f"{index:05d}_{p.name}") for index, p in enumerate(photographs)]
    points = _points(root, content)
    options.log(f"nerfstudio: {len(photographs)} images, {len(points.positions) if points else 0} points")
    return to_scene(root, photographs, options, points)


def _names(content: dict[str, Any], key: str, file: Path) -> list[str]:
    names = content.get(key, [])
    if not isinstance(names, list):
        raise SceneError(f"{file}: {key}", "a list of file names", type(names).__name__)
    return [Path(str(name)).as_posix() for name in names]


def _photograph(root: Path, entry: TransformsEntry, size: tuple[int, int], test: set[str], group: int) -> Photograph:
    camera, lens = _camera(entry, size)
    mask = entry.intrinsics.get("mask_path")
    return Photograph(
        entry.image_path.stem,
        entry.image_path,
        camera,
        lens,
        entry.time,
        group,
        test=Path(entry.file_path).as_posix() in test if test else None,
        mask=root / str(mask) if mask else None,
    )


def _camera(entry: TransformsEntry, size: tuple[int, int]) -> tuple[Camera, Lens | None]:
    values, where = entry.intrinsics, entry.where
    fisheye = values.get("camera_model") in FISHEYE or bool(values.get("is_fisheye"))
    camera = read_pinhole(values, size, entry.cam_to_world, where, entry.file)
    if fisheye:
        bent = tuple(read_number(values.get(key, 0.0), f"{where}: {key}", 1e6) for key in ("k1", "k2", "k3", "k4"))
        return camera, FisheyeLens(camera.fx, camera.fy, camera.cx, camera.cy, bent) if any(bent) else None
    bent = read_distortion(values, where)
    return camera, Undistortion.of(camera, *bent) if any(bent) else None


def _points(root: Path, content: dict[str, Any]) -> ScenePoints | None:
    """The point cloud that the file names, in the coordinates of the poses."""
    name = content.get("ply_file_path")
    if not isinstance(name, str):
        return None
    if not is_file(root / name):
        raise SceneError(root / name, "the points that transforms.json names (ply_file_path)", "no such file")
    return read_ply_points(root / name)


def read_ply_points(path: Path) -> ScenePoints | None:
    """x, y, z and red, green, blue of a .ply; grey without colours, None without points."""
    from plyfile import PlyData

    try:
        vertices = PlyData.read(str(path))["vertex"]
        positions = np.stack([np.asarray(vertices[axis], np.float64) for axis in "xyz"], axis=1)
        coloured = set(COLORS) <= {p.name for p in vertices.properties}
        colors = np.stack([np.asarray(vertices[c], np.float64) for c in COLORS], axis=1) if coloured else None
    except Exception as error:  # plyfile and numpy raise many types for broken files
        raise SceneError(path, "a .ply with the vertices x, y, z", str(error)) from None
    return scene_points(positions, colors)
