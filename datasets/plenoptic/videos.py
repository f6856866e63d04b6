"""Finds the video files of a folder, a camera each, and what they show."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

from datasets.files.contents import contents
from datasets.files.errors import SceneError
from datasets.files.natural_order import end_numbers, natural_order
from datasets.plenoptic.sync import drop_advice
from datasets.video_files.film import Film, open_film
from rasterizer.cores import thread_count

FOOTAGE_SUFFIXES = (
    ".mp4", ".mov", ".mkv", ".avi", ".m4v", ".webm", ".mts", ".m2ts", ".ts", ".mpg", ".mpeg", ".3gp",
)  # fmt: skip
PLENOPTIC_NAME = re.compile(r"cam_?(\d+)\.mp4", re.IGNORECASE)
CHAPTER = re.compile(r"(?:G[HXL](?P<part>\d\d)|GP(?P<old>\d\d)|GOPR)(?P<take>\d{4})", re.IGNORECASE)  # of GoPro


@dataclass(frozen=True)
class VideoFile:
    """A camera's video, not opened yet."""

    name: str
    number: int
    path: Path


@dataclass(frozen=True)
class Video:
    """A camera's film."""

    name: str
    number: int
    path: Path
    film: Film
    advice: str  # the setting that drops this camera, for messages


def find_cameras(root: Path) -> list[VideoFile]:
    """cam00.mp4, cam01.mp4, … of a folder, also cam_00.mp4 and in upper case, sorted by name as their poses are.

    A camera's number is the one in the name. Gaps are allowed.
    """
    return [
        VideoFile(path.stem, int(found[1]), path)
        for path in sorted(root.iterdir(), key=lambda path: path.name)
        if (found := PLENOPTIC_NAME.fullmatch(path.name))
    ]


def video_paths(folder: Path) -> list[Path]:
    """The videos of a folder, sorted. Hidden files are not the user's: file managers write them."""
    return sorted(p for p in folder.iterdir() if p.suffix.lower() in FOOTAGE_SUFFIXES and not p.name.startswith("."))


def find_footage(root: Path) -> list[VideoFile]:
    """All videos of a folder, in the natural order of their names."""
    if not root.is_dir():
        found = "a file" if root.exists() else "nothing there"
        raise SceneError(root, "a video, or a folder of videos or images in order", found)
    paths = sorted(video_paths(root), key=lambda path: natural_order(path.name))
    if not paths:
        raise SceneError(root, f"videos ({', '.join(FOOTAGE_SUFFIXES)}) or images in order", contents(root))
    stems = [path.stem for path in paths]
    for path in paths:
        if stems.count(path.stem) > 1:
            raise SceneError(path, "one video a camera", f"several called {path.stem}")
    _refuse_chapters(paths)
    return numbered({path.stem: path for path in paths})


def numbered(videos: Mapping[str, Path]) -> list[VideoFile]:
    """Cameras by their names, with the number that the name ends in, if all end in different ones, else their place."""
    numbers = end_numbers(list(videos))
    return [VideoFile(name, number, path) for number, (name, path) in zip(numbers, videos.items(), strict=True)]


def open_videos(
    files: Sequence[VideoFile],
    keep: Collection[int],
    drop: Collection[int],
    cache: Path,
    threads: int = 0,
    square: bool = True,
) -> tuple[Video, ...]:
    """The videos of the cameras `keep`. SceneError for one that is none.

    drop: the cameras dropped already, for the advice in messages. cache: see open_film. square: frames have square
    pixels; otherwise those that are stored.
    """
    kept = [file for file in files if file.number in keep]
    cores = thread_count(threads)

    def opened(file: VideoFile) -> Video:
        advice = drop_advice(file.number, drop)
        try:
            film = open_film(file.path, cache, max(1, cores // len(kept)))
        except SceneError as error:
            error.args = (f"{error}; {advice}",)
            raise
        return Video(file.name, file.number, file.path, film if square else replace(film, pixel_aspect=1.0), advice)

    with ThreadPoolExecutor(cores) as pool:
        return tuple(pool.map(opened, kept))


def _refuse_chapters(paths: Sequence[Path]) -> None:
    """SceneError for parts of one take, which cameras write when a file grows too large."""
    takes: dict[str, Path] = {}
    for path in paths:
        if found := CHAPTER.fullmatch(path.stem):
            first = takes.setdefault(found["take"], path)
            if first is not path:
                raise SceneError(
                    path,
                    "a camera of its own",
                    f"a chapter of the take that {first.name} is of too: join them (ffmpeg -f concat -i LIST -c copy "
                    f"{found['take']}.mp4), or leave one chapter in the folder",
                )
