"""scene=auto: which layout a folder has, and why it is none of the others."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from datasets.files.errors import SceneError, read_json
from datasets.layouts.colmap import sparse_folders
from datasets.layouts.llff import image_folder
from datasets.plenoptic.images import FRAME_NAME, SPLITS
from datasets.plenoptic.videos import FOOTAGE_SUFFIXES, PLENOPTIC_NAME

IMAGE_SUFFIX = re.compile(r"\.(png|jpe?g)$", re.IGNORECASE)


@dataclass(frozen=True)
class Detected:
    """The layout, as a value of scene.reader, and the reasons in one line."""

    reader: str
    line: str


def detect(path: Path) -> Detected:
    """SceneError, with the reason for each layout, for a folder that has none."""
    if path.suffix.lower() == ".json" and path.is_file():
        raise SceneError(path, f"the folder of the data, {path.parent}", "a file in it")
    if path.is_file():
        return Detected("video", f"{path.name}: taken for one clip (scene=video): it is a file")
    if not path.is_dir():
        raise SceneError(path, "a folder, or a video", "nothing there")
    refused: list[str] = []
    for reader, name, missing in _LAYOUTS:
        reason = missing(path)
        if reason is None:
            instead = f"; not {', '.join(refused)}" if refused else ""
            return Detected(reader, f"{path}: taken for {name} (scene.reader={reader}){instead}")
        refused.append(f"{name} ({reason})")
    known = "a layout that is known (driving logs: scene=kitti or scene=waymo)"
    raise SceneError(path, known, f"none: not {', '.join(refused)}")


def _dynamic_gaussians(path: Path) -> str | None:
    return None if (path / "train_meta.json").is_file() else "no train_meta.json"


def _nerfies(path: Path) -> str | None:
    if not (path / "dataset.json").is_file():
        return "no dataset.json"
    return None if (path / "camera").is_dir() and (path / "rgb").is_dir() else "no camera/ and rgb/"


def _plenoptic(path: Path) -> str | None:
    numbered = any(PLENOPTIC_NAME.fullmatch(p.name) for p in path.iterdir())
    posed = (path / "poses_bounds.npy").is_file()
    if numbered and posed or _plenoptic_images(path):
        return None
    if posed and _has_videos(path) and image_folder(path) is None:
        return "poses_bounds.npy is there and not used: the videos are not called cam00.mp4, cam01.mp4, …"
    return "no cam00.mp4 with poses_bounds.npy, no images/cam00_0000 in transforms_train.json"


def _plenoptic_images(path: Path) -> bool:
    """Whether the transforms files name several frames of cameras that stand still, as plenoptic/images.py reads them,
    each in one of the files. Files without that, or that cannot be read, are left to other readers."""
    poses: dict[str, list] = {}
    named: list[set[str]] = []
    for split in SPLITS:
        before = {name: len(of_one) for name, of_one in poses.items()}
        try:
            for frame in read_json(path / f"transforms_{split}.json", SceneError)["frames"]:
                name = FRAME_NAME.fullmatch(IMAGE_SUFFIX.sub("", Path(frame["file_path"]).name))
                if name is None:
                    return False
                poses.setdefault(name["camera"], []).append(frame["transform_matrix"])
        except (OSError, SceneError, TypeError, KeyError):
            return False
        named.append({name for name, of_one in poses.items() if len(of_one) > before.get(name, 0)})
    if set.intersection(*named):  # held out are times, not cameras
        return False
    return len(poses) > 1 and all(len(of_one) > 1 and all(p == of_one[0] for p in of_one) for of_one in poses.values())


def _dnerf(path: Path) -> str | None:
    return None if (path / "transforms_train.json").is_file() else "no transforms_train.json"


def _nerfstudio(path: Path) -> str | None:
    return None if (path / "transforms.json").is_file() else "no transforms.json"


def _colmap(path: Path) -> str | None:
    return None if sparse_folders(path) else "no sparse/0 with images.bin or images.txt"


def _llff(path: Path) -> str | None:
    if not (path / "poses_bounds.npy").is_file():
        return "no poses_bounds.npy"
    return None if image_folder(path) is not None else "no images/"


def _video(path: Path) -> str | None:
    from datasets.video_files.decode import image_paths

    if _has_videos(path) or image_paths(path):
        return None
    inner = path / "images"
    hint = f"; scene.path={inner} takes its images for one clip" if inner.is_dir() and image_paths(inner) else ""
    return f"no videos and no images{hint}"


def _has_videos(path: Path) -> bool:
    return any(p.suffix.lower() in FOOTAGE_SUFFIXES and not p.name.startswith(".") for p in path.iterdir())


# Value of scene.reader, name, and what is missing (None: nothing). The most telling files come first.
_LAYOUTS: tuple[tuple[str, str, Callable[[Path], str | None]], ...] = (
    ("dynamic_gaussians", "Dynamic 3D Gaussians", _dynamic_gaussians),
    ("nerfies", "Nerfies, HyperNeRF or DyCheck", _nerfies),
    ("plenoptic", "Plenoptic Video", _plenoptic),
    ("dnerf", "D-NeRF", _dnerf),
    ("nerfstudio", "nerfstudio", _nerfstudio),
    ("colmap", "COLMAP", _colmap),
    ("llff", "NVIDIA Dynamic Scenes (LLFF poses)", _llff),
    ("video", "videos or images without poses", _video),
)
