"""Reader of the folder of Nerfies, HyperNeRF and DyCheck.

    dataset.json        {"ids", "train_ids", "val_ids"}; DyCheck also has splits/train.json, val.json
    metadata.json       {id: {"warp_id" or "time_id": frame in time, "camera_id", …}}
    camera/<id>.json    {"orientation": 3×3 world-to-camera, "position", "focal_length", "principal_point", "skew",
                         "pixel_aspect_ratio", "radial_distortion": k1 k2 k3, "tangential_distortion": p1 p2,
                         "image_size"}
    rgb/1x, 2x, …       <id>.png
    points.npy          (N, 3), optional
    covisible/2x/val    DyCheck, scaled to the images in use: <id>.png, white where a training frame sees the pixel too

Camera axes are OpenCV's. Evaluated over covisible pixels where there are masks (DyCheck's mPSNR).
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from datasets.cameras.intrinsics import LARGEST_COEFFICIENT
from datasets.cameras.lens import Undistortion
from datasets.cameras.transforms import read_pose
from datasets.composition import chosen_downscale
from datasets.files.errors import SceneError
from datasets.files.image_files import common_size
from datasets.files.json_values import get_key, read_number, read_object
from datasets.photographs.photograph import PosedFile
from datasets.photographs.points import scene_points
from datasets.photographs.scene import to_scene
from datasets.scene import Scene, ScenePoints, make_camera
from datasets.settings import SceneConfig
from datasets.source import Log
from rasterizer.camera import Camera

TIME_KEYS = ("time_id", "warp_id", "appearance_id")
LATEST = 1e9  # frames
TITLE, PRECEDENCE = "Nerfies, HyperNeRF or DyCheck", 20


def matches(path: Path) -> str | None:
    if not (path / "dataset.json").is_file():
        return "no dataset.json"
    return None if (path / "camera").is_dir() and (path / "rgb").is_dir() else "no camera/ and rgb/"


def read(root: Path, cfg: SceneConfig, log: Log) -> Scene:
    """The scene, with the layout's own split where it holds out frames."""
    ids, test = _split(root)
    factor, remaining = _scale_folder(root, cfg.downscale, ids)
    metadata = _object(root / "metadata.json") if (root / "metadata.json").is_file() else {}
    size = common_size([root / "rgb" / f"{factor}x" / f"{name}.png" for name in ids])
    photographs = [_photograph(root, name, factor, size, metadata, name in test if test else None) for name in ids]
    points = _read_points(root / "points.npy", log)
    log(
        f"Nerfies: {len(ids)} frames of rgb/{factor}x, {size[0]} x {size[1]}, {len(test)} held out by the folder, "
        f"{len(points.positions) if points else 0} points"
    )
    return to_scene(root, photographs, replace(cfg, downscale=remaining), log, points)


def _split(root: Path) -> tuple[list[str], set[str]]:
    """(ids in use, those held out)."""
    content = _object(root / "dataset.json")
    file, key = root / "dataset.json", "train_ids" if content.get("train_ids") else "ids"
    train, test = _ids(content, key, file), _ids(content, "val_ids", file)
    if (root / "splits" / "train.json").is_file() and (root / "splits" / "val.json").is_file():  # DyCheck
        train, test = (
            _ids(_object(root / "splits" / f"{split}.json"), "frame_names", root / "splits" / f"{split}.json")
            for split in ("train", "val")
        )
    if not train:
        raise SceneError(file, "train_ids or ids", "none")
    return list(dict.fromkeys(train + test)), set(test) - set(train)


def _ids(content: dict[str, Any], key: str, file: Path) -> list[str]:
    """Names of frames; none where the key is missing."""
    names = content.get(key) or []
    if not isinstance(names, list):
        raise SceneError(f"{file}: {key}", "a list of names", type(names).__name__)
    return [str(name) for name in names]


def _scale_folder(root: Path, downscale: int, ids: list[str]) -> tuple[int, int]:
    """The reduction of the folder rgb/<factor>x in use, and what remains of scene.downscale on reading.

    The largest factor that divides scene.downscale; without one images are reduced by the least possible above it.
    """
    folders = sorted(int(p.name[:-1]) for p in root.glob("rgb/*x") if re.fullmatch(r"[1-9]\d?x", p.name) and p.is_dir())
    if not folders:
        raise SceneError(root / "rgb", "a folder 1x, 2x, 4x, …", "none")
    wanted = downscale
    if not wanted:
        width, height = common_size([root / "rgb" / f"{folders[0]}x" / f"{ids[0]}.png"])
        wanted = chosen_downscale((width * folders[0], height * folders[0]))
    remaining = {factor: -(-wanted // factor) for factor in folders}
    factor = min(folders, key=lambda factor: (factor * remaining[factor], -factor))
    return factor, remaining[factor]


def _photograph(
    root: Path, name: str, factor: int, size: tuple[int, int], metadata: dict[str, Any], test: bool | None
) -> PosedFile:
    camera, lens = _camera(root / "camera" / f"{name}.json", size)
    record = metadata.get(name) if isinstance(metadata.get(name), dict) else {}
    assert isinstance(record, dict)
    where = f"{root / 'metadata.json'}: {name}"
    time = next((read_number(record[key], f"{where}: {key}", LATEST) for key in TIME_KEYS if key in record), None)
    group = int(read_number(record.get("camera_id", 0), f"{where}: camera_id", 1e6))
    factors = [factor, *(other for other in (1, 2, 4, 8) if other != factor)]  # DyCheck has 2 alone
    masks = [root / "covisible" / f"{other}x" / "val" / f"{name}.png" for other in factors]
    mask = next((path for path in masks if path.is_file()), None)
    path = root / "rgb" / f"{factor}x" / f"{name}.png"
    return PosedFile(name, path, camera, lens, time, group, test, mask)


def _camera(file: Path, size: tuple[int, int]) -> tuple[Camera, Undistortion | None]:
    """The camera of an image of `size`; the file's intrinsics are those of image_size."""
    content, where = _object(file), str(file)
    rotation = np.eye(4)
    rotation[:3, :3] = _numbers(content, "orientation", (3, 3), file)
    pose = np.linalg.inv(read_pose(rotation.tolist(), f"{where}: orientation"))
    pose[:3, 3] = _numbers(content, "position", (3,), file)
    width, height = (int(side) for side in _numbers(content, "image_size", (2,), file))
    focal = read_number(get_key(content, "focal_length", file), f"{where}: focal_length")
    aspect = read_number(content.get("pixel_aspect_ratio", 1.0), f"{where}: pixel_aspect_ratio")
    if read_number(content.get("skew", 0.0), f"{where}: skew") != 0:
        raise SceneError(f"{where}: skew", "0: sheared pixels are not supported", f"{content['skew']}")
    cx, cy = _numbers(content, "principal_point", (2,), file)
    full = make_camera(file, lambda: Camera(width, height, focal, focal * aspect, cx, cy, np.linalg.inv(pose)))
    camera = full.resized(*size)
    radial = _numbers(content, "radial_distortion", (3,), file) if "radial_distortion" in content else np.zeros(3)
    key = "tangential_distortion" if "tangential_distortion" in content else "tangential"
    tangential = _numbers(content, key, (2,), file) if key in content else np.zeros(2)
    bent = tuple(float(x) for x in (radial[0], radial[1], *tangential, radial[2]))
    if max(map(abs, bent)) > LARGEST_COEFFICIENT:
        raise SceneError(f"{where}: radial_distortion, {key}", f"numbers within ±{LARGEST_COEFFICIENT:g}", f"{bent}")
    return camera, Undistortion.of(camera, *bent) if any(bent) else None


def _numbers(content: dict[str, Any], key: str, shape: tuple[int, ...], file: Path) -> np.ndarray:
    try:
        values = np.array(get_key(content, key, file), dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        values = np.zeros(())
    if values.shape != shape or not np.isfinite(values).all():
        raise SceneError(f"{file}: {key}", f"finite numbers of shape {shape}", f"{content.get(key)!r}")
    return values


def _object(file: Path) -> dict[str, Any]:
    return read_object(file, kind="a file (layout of Nerfies)")


def _read_points(path: Path, log: Log) -> ScenePoints | None:
    if not path.is_file():
        return None
    try:
        points = np.asarray(np.load(path, allow_pickle=False), dtype=np.float64)
    except Exception as error:  # numpy raises many types for broken files
        raise SceneError(path, "points (N, 3)", str(error)) from None
    if points.ndim != 2 or points.shape[1] != 3:
        raise SceneError(path, "points (N, 3)", f"{points.shape}")
    return scene_points(points, None, log)
