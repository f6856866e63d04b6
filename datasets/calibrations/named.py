"""Which videos or images are by which camera of a calibration: by the names of files and folders."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from datasets.files.errors import SceneError
from datasets.files.natural_order import natural_order
from datasets.plenoptic.videos import VideoFile, find_footage, numbered, video_paths
from datasets.source import Log
from datasets.video_files.image_folder import image_paths


def filmed(root: Path) -> list[VideoFile]:
    """The videos of a folder, or the one in each of its folders, called after that folder; none without videos.

    SceneError for a folder with several.
    """
    if video_paths(root):
        return find_footage(root)
    folders = sorted((p for p in root.iterdir() if p.is_dir()), key=lambda folder: natural_order(folder.name))
    found = {folder: video_paths(folder) for folder in folders}
    for folder, videos in found.items():
        if len(videos) > 1:
            expected = "one video, the camera's: join the parts of a take, or leave one in the folder"
            raise SceneError(folder, expected, f"{len(videos)}, {videos[0].name}, {videos[1].name}")
    return numbered({folder.name: videos[0] for folder, videos in found.items() if videos})


def photographed(root: Path) -> dict[str, list[Path]]:
    """The images of each of the folders, by its name; else those of `root`, one a camera, by their names."""
    folders = {folder.name: image_paths(folder) for folder in sorted(root.iterdir()) if folder.is_dir()}
    found = {name: paths for name, paths in folders.items() if paths}
    return found or {path.stem: [path] for path in image_paths(root)}


def matched(names: Sequence[str], files: Mapping[str, str], where: str, log: Log) -> dict[str, str]:
    """Key of `files` -> the camera of that name. files: key -> the words that name it, a folder's and the file's.

    A name that is the key, or else that occurs in the words, as `back` in back/minimal_back.mp4 and 1 in cam_01.mp4. A
    line names cameras without files. SceneError unless each of `files` has one camera and no camera two.
    """
    found: dict[str, str] = {}
    for key, words in files.items():
        own = [name for name in names if _words(name) == _words(key)]
        own = own or [name for name in names if _occurs(_words(name), _words(words))]
        # cam1 in `rig_cam1`, not the 1 of another camera called 1
        longest = max((len(_words(name)) for name in own), default=0)
        own = [name for name in own if len(_words(name)) == longest]
        if len(own) != 1:
            expected = f"the name of one camera of {where}: {', '.join(names)}"
            raise SceneError(
                words, expected, f"{', '.join(own) if own else 'none of them'}; rename the file, or its folder"
            )
        if (other := next((k for k, name in found.items() if name == own[0]), None)) is not None:
            raise SceneError(words, f"a camera of its own in {where}", f"{own[0]}, which is {other} too; rename one")
        found[key] = own[0]
    if missing := [name for name in names if name not in found.values()]:
        log(f"{where}: cameras without files, which are left out: {', '.join(missing)}")
    return found


def _words(name: str) -> tuple[str, ...]:
    """Runs of letters and of digits, without leading zeros."""
    parts = re.findall(r"[a-z]+|[0-9]+", name.lower())
    return tuple(part.lstrip("0") or "0" if part.isdigit() else part for part in parts)


def _occurs(short: tuple[str, ...], long: tuple[str, ...]) -> bool:
    return any(long[i : i + len(short)] == short for i in range(len(long) - len(short) + 1)) and bool(short)
