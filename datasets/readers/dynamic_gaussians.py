"""Reader of Dynamic 3D Gaussians' folder: several calibrated, synchronised cameras (Luiten et al., 3DV 2024).

    train_meta.json   {"w", "h", "k": T×C×3×3, "w2c": T×C×4×4, "fn": T×C names, "cam_id": T×C}
    test_meta.json    the same of the held-out cameras; optional
    ims/<fn>          the images; init_pt_cld.npz: "data" (N, 7) x, y, z, r, g, b in [0, 1], segment; optional

Poses have OpenCV's camera axes. Time is the frame's place in the list.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from datasets.cameras.transforms import read_pose
from datasets.files.errors import SceneError
from datasets.files.image_files import is_file
from datasets.files.json_values import get_key, read_number, read_object
from datasets.files.named_files import named_path, say_renamed
from datasets.photographs.photograph import PosedFile
from datasets.photographs.points import scene_points
from datasets.photographs.scene import to_scene
from datasets.scene import Scene, ScenePoints, make_camera
from datasets.settings import SceneConfig
from datasets.source import Log
from rasterizer.camera import Camera

TABLES = "an object with k, w2c, fn, cam_id"
MIRROR = np.diag([-1.0, 1.0, 1.0, 1.0])
TITLE, PRECEDENCE = "Dynamic 3D Gaussians", 10


def matches(path: Path) -> str | None:
    return None if (path / "train_meta.json").is_file() else "no train_meta.json"


def read(root: Path, cfg: SceneConfig, log: Log) -> Scene:
    """The scene; without test_meta.json, scene.test_cameras are held out, by their number in cam_id."""
    if (root / "test_meta.json").is_file():
        photographs = _read_meta(root, "train_meta.json", False, log) + _read_meta(root, "test_meta.json", True, log)
    else:
        photographs = _read_meta(root, "train_meta.json", None, log)
    mirrored = _is_mirrored(read_object(root / "train_meta.json", TABLES)["w2c"])
    if mirrored:
        log("train_meta.json: all poses are reflections; the world is mirrored back")
    points = _read_points(root / "init_pt_cld.npz", log)
    if points is not None and mirrored:
        points = replace(points, positions=points.positions @ MIRROR[:3, :3])
    cameras = sorted({photograph.group for photograph in photographs})
    log(
        f"Dynamic 3D Gaussians: {len(cameras)} cameras ({', '.join(map(str, cameras))}), {len(photographs)} images, "
        f"{len(points.positions) if points else 0} points"
    )
    return to_scene(root, photographs, cfg, log, points)


def _read_meta(root: Path, name: str, test: bool | None, log: Log) -> list[PosedFile]:
    """The images that the file names. One that is not there is left out, and their number is said."""
    file = root / name
    content = read_object(file, TABLES)
    width, height = (int(read_number(get_key(content, key, file), f"{file}: {key}", 1e6)) for key in "wh")
    tables = {key: get_key(content, key, file) for key in ("k", "w2c", "fn", "cam_id")}
    times = len(tables["fn"]) if isinstance(tables["fn"], list) else 0
    for key, table in tables.items():
        if not isinstance(table, list) or len(table) != times or not times:
            raise SceneError(f"{file}: {key}", f"a list of {times} frames", _kind(table))
    mirrored = _is_mirrored(tables["w2c"])
    found: list[PosedFile] = []
    stated: list[Path] = []
    missing: list[Path] = []
    for t in range(times):
        row = {key: table[t] for key, table in tables.items()}
        lengths = {key: len(value) if isinstance(value, list) else -1 for key, value in row.items()}
        if len(set(lengths.values())) != 1 or lengths["fn"] < 1:
            raise SceneError(f"{file}: frame {t}", "as many cameras in k, w2c, fn and cam_id", f"{lengths}")
        for c in range(lengths["fn"]):
            where = f"{file}: frame {t}, camera {c}"
            path = named_path(root / "ims", str(row["fn"][c]))
            if not is_file(path):
                missing.append(path)
                continue
            camera = _camera(row["k"][c], row["w2c"][c], (width, height), mirrored, where)
            number = int(read_number(row["cam_id"][c], f"{where}: cam_id", 1e6))
            stated.append(root / "ims" / str(row["fn"][c]))
            found.append(PosedFile(f"cam{number:02d}_{t:05d}", path, camera, None, float(t), number, test))
    say_renamed(file, stated, (photograph.path for photograph in found), log)
    if missing and not found:
        raise SceneError(missing[0], f"an image that {name} names", "no such file")
    if missing:
        named = len(missing) + len(found)
        log(f"{name} names {named} images; left out: {len(missing)} that are not there, the first {missing[0]}")
    return found


def _is_mirrored(rows: list[Any]) -> bool:
    """Whether every pose is a reflection. Some calibrations are of a mirrored world; mirrored back, images stay."""
    try:
        matrices = np.array([pose for row in rows for pose in row], dtype=np.float64)
        with np.errstate(all="ignore"):
            return bool(len(matrices)) and bool((np.linalg.det(matrices[:, :3, :3]) < 0).all())
    except (TypeError, ValueError, OverflowError, IndexError):
        return False  # refused one by one


def _camera(k: Any, w2c: Any, size: tuple[int, int], mirrored: bool, where: str) -> Camera:
    matrix = _matrix(k)
    if matrix.shape != (3, 3) or not np.isfinite(matrix).all() or abs(matrix[0, 1]) > 1e-3 * abs(matrix[0, 0]):
        raise SceneError(f"{where}: k", "3 x 3 numbers without skew", _kind(k))
    world_to_cam = _matrix(w2c)
    if world_to_cam.shape == (4, 4) and mirrored:
        world_to_cam = world_to_cam @ MIRROR
    pose = read_pose(world_to_cam.tolist(), f"{where}: w2c")
    return make_camera(where, lambda: Camera(*size, matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], pose))


def _matrix(value: Any) -> np.ndarray:
    """The numbers of nested lists; () of what is none."""
    try:
        return np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError, RecursionError):
        return np.zeros(())


def _read_points(path: Path, log: Log) -> ScenePoints | None:
    if not path.is_file():
        return None
    try:
        with np.load(path, allow_pickle=False) as content:
            table = np.asarray(content["data"], dtype=np.float64)
    except Exception as error:  # numpy and zipfile raise many types for broken files
        raise SceneError(path, "points (data, N x 7)", str(error)) from None
    if table.ndim != 2 or table.shape[1] < 6:
        raise SceneError(path, "points (data, N x 7)", f"{table.shape}")
    return scene_points(table[:, :3], table[:, 3:6], log)


def _kind(value: Any) -> str:
    return f"{type(value).__name__} of {len(value)}" if isinstance(value, list) else repr(value)
