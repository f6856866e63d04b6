"""Reader of nerfstudio's folder: transforms.json and images, as ns-process-data writes them.

    {"camera_model": "OPENCV", "fl_x", "fl_y", "cx", "cy", "w", "h", "k1", "k2", "p1", "p2": shared or of each frame,
     "ply_file_path": "sparse_pc.ply", "applied_transform": 3×4, of the points and the poses alike,
     "train_filenames", "val_filenames", "test_filenames": optional, each a list of file_path,
     "frames": [{"file_path", "transform_matrix": 4×4 camera-to-world, "mask_path", "time" or "timestamp"}, …]}

Poses have OpenGL's camera axes. Masks are 0 where pixels do not count.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

from datasets.cameras.intrinsics import read_distortion, read_pinhole, stated_shape
from datasets.cameras.lens import FisheyeLens, Lens, Undistortion
from datasets.cameras.transforms import TransformsEntry, read_transforms
from datasets.files.errors import SceneError, read_json
from datasets.files.image_files import is_file, oriented_size
from datasets.files.json_values import read_number
from datasets.files.named_files import named_path, say_renamed
from datasets.photographs.file_names import by_name
from datasets.photographs.photograph import PosedFile
from datasets.photographs.points import read_ply_points
from datasets.photographs.scene import to_scene
from datasets.scene import Scene, ScenePoints
from datasets.settings import SceneConfig
from datasets.source import Log
from rasterizer.camera import Camera

FISHEYE = ("OPENCV_FISHEYE", "FISHEYE", "SIMPLE_FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE")
TITLE, PRECEDENCE = "nerfstudio", 50


def matches(path: Path) -> str | None:
    return None if (path / "transforms.json").is_file() else "no transforms.json"


def read(root: Path, cfg: SceneConfig, log: Log) -> Scene:
    """The scene. SceneError for invalid data and for cameras that are no perspective or fisheye lens."""
    file = root / "transforms.json"
    entries = read_transforms(file, root)
    say_renamed(file, (root / entry.file_path for entry in entries), (entry.image_path for entry in entries), log)
    content = read_json(file, SceneError)
    used = _in_use(root, entries, content, file, log)
    (path, count), *_ = Counter(entry.image_path.resolve() for entry, _ in used).most_common(1) or [(root, 0)]
    if count > 1:  # it would be trained on and held out
        raise SceneError(file, "each image once", f"{path} {count} times")
    photographs = [_photograph(root, entry, test) for entry, test in used]
    points = _points(root, content, log)
    log(f"nerfstudio: {len(photographs)} images, {len(points.positions) if points else 0} points")
    return to_scene(root, by_name(root, photographs, log), cfg, log, points)


def _in_use(
    root: Path, entries: list[TransformsEntry], content: dict[str, Any], file: Path, log: Log
) -> list[tuple[TransformsEntry, bool | None]]:
    """The frames in use, each with whether the lists of file names hold it out; None: they hold out none.

    As in nerfstudio, frames in no list are left out; without train_filenames they are trained on.
    """
    names = [{root / entry.file_path, entry.image_path} for entry in entries]
    known = set().union(*names)
    train, val, test = (_listed(root, content, f"{split}_filenames", file, known) for split in ("train", "val", "test"))
    held_out = val | test
    kept = [
        (entry, bool(own & held_out) if held_out else None)
        for entry, own in zip(entries, names)
        if not train or own & (train | held_out)
    ]
    if left_out := len(entries) - len(kept):
        log(f"{file.name}: {left_out} of {len(entries)} frames are in no list of file names and left out")
    return kept


def _listed(root: Path, content: dict[str, Any], key: str, file: Path, known: set[Path]) -> set[Path]:
    """The paths that a list of file names has; SceneError unless all are `known`."""
    names = content.get(key, [])
    if not isinstance(names, list):
        raise SceneError(f"{file}: {key}", "a list of file names", type(names).__name__)
    paths = {named_path(root, str(name)): name for name in names}
    if unknown := [name for path, name in paths.items() if path not in known]:
        raise SceneError(f"{file}: {key}", "names that frames have as file_path", f"{unknown[0]!r}")
    return set(paths)


def _photograph(root: Path, entry: TransformsEntry, test: bool | None) -> PosedFile:
    size, _ = oriented_size(entry.image_path, stated_shape(entry.intrinsics))
    camera, lens = _camera(entry, size)
    mask, stamp, time = entry.intrinsics.get("mask_path"), entry.intrinsics.get("timestamp"), entry.time
    if time is None and stamp is not None:
        time = read_number(stamp, f"{entry.where}: timestamp")
    return PosedFile(
        entry.image_path.stem,
        entry.image_path,
        camera,
        lens,
        time,
        test=test,
        mask=named_path(root, str(mask)) if mask else None,
    )


def _camera(entry: TransformsEntry, size: tuple[int, int]) -> tuple[Camera, Lens | None]:
    values, where = entry.intrinsics, entry.where
    fisheye = values.get("camera_model") in FISHEYE or bool(values.get("is_fisheye"))
    camera = read_pinhole(values, size, entry.cam_to_world, where, entry.file)
    if fisheye:
        bent = tuple(read_number(values.get(key, 0.0), f"{where}: {key}", 1e6) for key in ("k1", "k2", "k3", "k4"))
        return camera, FisheyeLens(camera.fx, camera.fy, camera.cx, camera.cy, bent)
    bent = read_distortion(values, where)
    return camera, Undistortion.of(camera, *bent) if any(bent) else None


def _points(root: Path, content: dict[str, Any], log: Log) -> ScenePoints | None:
    """The point cloud that the file names, in the coordinates of the poses."""
    name = content.get("ply_file_path")
    if not isinstance(name, str):
        return None
    path = named_path(root, name)
    if not is_file(path):
        raise SceneError(path, "the points that transforms.json names (ply_file_path)", "no such file")
    return read_ply_points(path, log)
