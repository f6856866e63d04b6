"""Reader of images with LLFF's poses_bounds.npy, one row an image: NVIDIA Dynamic Scenes and its kin.

    DIR/images/000.png, …     frames in the order of their names; also DIR/images_960x540 and the like
    DIR/poses_bounds.npy      (N, 17): see datasets/plenoptic/poses.py

In NVIDIA Dynamic Scenes every frame is from the next camera of a rig, one camera that moves.
"""

from __future__ import annotations

from pathlib import Path

from datasets.files.errors import SceneError
from datasets.files.image_files import common_size
from datasets.photographs.photograph import PosedFile
from datasets.photographs.scene import to_scene
from datasets.plenoptic.poses import read_poses
from datasets.scene import Scene
from datasets.settings import SceneConfig
from datasets.source import Log

SUFFIXES = (".png", ".jpg", ".jpeg")
TITLE, PRECEDENCE = "NVIDIA Dynamic Scenes (LLFF poses)", 70


def matches(path: Path) -> str | None:
    if not (path / "poses_bounds.npy").is_file():
        return "no poses_bounds.npy"
    return None if image_folder(path) is not None else "no images/"


def image_folder(root: Path) -> Path | None:
    """images, else the first folder images_…; None without one."""
    folders = sorted(p for p in root.glob("images*") if p.is_dir() and "colmap" not in p.name and _images(p))
    return next((p for p in folders if p.name == "images"), folders[0] if folders else None)


def read(root: Path, cfg: SceneConfig, log: Log) -> Scene:
    """The scene. SceneError unless there are as many images as poses."""
    folder = image_folder(root)
    if folder is None:
        raise SceneError(root, "a folder images with .png or .jpg", "none")
    paths = _images(folder)
    size = common_size(paths)
    names = [path.stem for path in paths]
    if len(set(names)) < len(names):
        raise SceneError(folder, "each image once", f"{len(names) - len(set(names))} names twice, in two formats")
    poses = read_poses(root / "poses_bounds.npy", names, names, size)
    photographs = [PosedFile(name, path, poses.cameras[name]) for name, path in zip(names, paths)]
    log(f"LLFF: {len(photographs)} images of {folder.name}, {size[0]} x {size[1]}")
    return to_scene(root, photographs, cfg, log)


def _images(folder: Path) -> list[Path]:
    return sorted(p for p in folder.iterdir() if p.suffix.lower() in SUFFIXES and not p.name.startswith("."))
