"""The ways to split the names of photographs into camera and moment, and which of them the poses bear out."""

from __future__ import annotations

import os
import re
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from pathlib import Path

import numpy as np

from datasets.files.errors import SceneError
from datasets.files.natural_order import natural_order
from datasets.photographs.photograph import PosedFile

SHARED_MOMENTS = 0.5  # of the camera with the fewest: as many moments in common make two names two cameras
SAME_PLACE = 1e-6  # of the distance between cameras; two of a car are 1e-2 of its way apart
ESTIMATED_PLACE = 0.05  # likewise, where structure from motion found each pose by itself
SYSTEMATIC = 0.9  # share of a common displacement, from which it is a rig's and no noise
RIGID = 1e-3  # relative change of the poses of a rig's cameras to each other
MOST_NUMBERS = 6  # of a name that are tried in all combinations
CAMERA_WORD = re.compile(r"(?<![a-z])(cam|camera|view|viewpoint|c|v)[\W_]*$", re.IGNORECASE)
MOMENT_WORD = re.compile(r"(?<![a-z])(frame|time|timestep|t|f)[\W_]*$", re.IGNORECASE)


@dataclass(frozen=True)
class NameSplit:
    """One way to read the names."""

    poses: np.ndarray  # (N, 4, 4) camera-to-world
    cameras: tuple[str, ...]  # of each photograph
    moments: tuple[str, ...]
    by_words: bool = False  # a word before the numbers says so: cam, frame
    by_folders: bool = False  # the folder is the camera, the file the moment

    def __str__(self) -> str:
        names = sorted(set(self.cameras), key=natural_order)
        return f"{len(names)} cameras ({names[0]} … {names[-1]}) × {len(set(self.moments))} times"

    @cached_property
    def is_possible(self) -> bool:
        """Two cameras or more, each with several moments and no moment twice."""
        unique = len(set(zip(self.moments, self.cameras))) == len(self.cameras)
        return unique and len(set(self.cameras)) > 1 and min(Counter(self.cameras).values()) > 1

    @cached_property
    def is_shared(self) -> bool:
        """Whether the cameras have moments in common."""
        found: dict[str, set[str]] = defaultdict(set)
        for camera, moment in zip(self.cameras, self.moments):
            found[camera].add(moment)
        return len(set.intersection(*found.values())) >= SHARED_MOMENTS * min(map(len, found.values()))

    @cached_property
    def _of_camera(self) -> dict[str, dict[str, np.ndarray]]:
        """Camera → moment → (12,) position, in units of the spread of all, and rotation."""
        spread = float(np.ptp(self.poses[:, :3, 3], axis=0).max()) or 1.0
        found: dict[str, dict[str, np.ndarray]] = defaultdict(dict)
        for camera, moment, pose in zip(self.cameras, self.moments, self.poses):
            found[camera][moment] = np.concatenate([pose[:3, 3] / spread, pose[:3, :3].ravel()])
        return found

    @cached_property
    def moved(self) -> float:
        """How far a camera moves at most, of the distance between cameras."""
        moved = max(float(np.ptp(np.stack([*own.values()]), axis=0).max()) for own in self._of_camera.values())
        means = np.stack([np.mean([*own.values()], axis=0) for own in self._of_camera.values()])
        apart = float(np.ptp(means, axis=0).max())
        return moved / apart if apart > 0 else np.inf

    @cached_property
    def moves_together(self) -> bool:
        """Whether what moves the cameras moves all alike in their own axes, as a car moves its own, and is no noise."""
        displacements = defaultdict(list)
        for own in self._of_camera.values():
            first, *rest = sorted(own, key=natural_order)
            for moment in rest:
                displacements[moment].append(own[first][3:].reshape(3, 3).T @ (own[moment] - own[first])[:3])
        common = [np.linalg.norm(np.mean(of_all, axis=0)) for of_all in displacements.values()]
        single = [np.sqrt(np.mean(np.sum(np.square(of_all), axis=1))) for of_all in displacements.values()]
        return bool(np.sum(common) > SYSTEMATIC * np.sum(single))

    @cached_property
    def is_rigid(self) -> bool:
        """Whether the cameras keep their places to each other, as those of a rig that moves."""
        by_moment: dict[str, dict[str, np.ndarray]] = defaultdict(dict)
        for camera, moment, pose in zip(self.cameras, self.moments, self.poses):
            by_moment[moment][camera] = pose
        relative: dict[tuple[str, str], list[np.ndarray]] = defaultdict(list)
        for own in by_moment.values():
            first, *rest = sorted(own)
            for camera in rest:
                relative[first, camera].append((np.linalg.inv(own[first]) @ own[camera])[:3])
        if not relative or min(map(len, relative.values())) < 2:
            return False
        size = max(float(np.abs(np.stack(found)[:, :, 3]).max()) for found in relative.values()) or 1.0
        changes = [np.ptp(np.stack(found), axis=0) / ([1.0] * 3 + [size]) for found in relative.values()]
        return max(float(change.max()) for change in changes) <= RIGID


def find_split(root: Path, photographs: Sequence[PosedFile]) -> tuple[NameSplit | None, str]:
    """(the split that the poses or, where they do not tell, the names bear out, what bears it out); (None, "") if the
    names tell no cameras apart. SceneError if several would fit."""
    names, poses = _names(photographs), np.stack([np.linalg.inv(p.camera.world_to_cam) for p in photographs])
    splits = [split for split in _all_splits(names, poses) if split.is_possible]
    still = [split for split in splits if split.moved <= SAME_PLACE]
    splits = [split for split in splits if split.is_shared]
    if not (still or splits):  # 0103: camera 1, frame 3
        still = [split for split in _cut_numbers(names, poses) if split.is_possible and split.moved <= SAME_PLACE]
    if still:
        return _only(root, _coarsest(still), "that stand still")
    if len(splits) < 2:
        return (splits[0] if splits else None), "by their names"
    if named := [split for split in splits if split.by_words]:
        return _only(root, _coarsest(named), "by their names")
    almost = [split for split in splits if split.moved <= ESTIMATED_PLACE and not split.moves_together]
    in_folders = [split for split in splits if split.by_folders]
    if almost:
        found = _coarsest(almost)
        return _only(root, found + [s for s in in_folders if s.cameras != found[0].cameras], "that nearly stand still")
    if len(rigid := [split for split in splits if split.is_rigid]) == 1:
        return rigid[0], "that keep their places to each other"
    return _only(root, in_folders or splits, "by their folders")


def _coarsest(splits: Sequence[NameSplit]) -> list[NameSplit]:
    """Those of the fewest cameras, each partition once: if a camera's images have one pose, so have those of each part
    of it."""
    fewest = min(len(set(split.cameras)) for split in splits)
    by_partition: dict[tuple[int, ...], NameSplit] = {}
    for split in sorted(splits, key=lambda split: len(set(split.moments))):
        if len(set(split.cameras)) == fewest:
            numbers = {name: number for number, name in enumerate(dict.fromkeys(split.cameras))}
            by_partition.setdefault(tuple(numbers[name] for name in split.cameras), split)
    return list(by_partition.values())


def _only(root: Path, splits: Sequence[NameSplit], why: str) -> tuple[NameSplit, str]:
    if len(splits) > 1:
        raise SceneError(
            root,
            "names of one camera and one moment each (a folder for each camera: camera_1/frame_0001.png)",
            "names and poses that fit " + " and ".join(map(str, splits[:3])),
        )
    return splits[0], why


def _names(photographs: Sequence[PosedFile]) -> list[str]:
    """Paths without suffix, from the folder that all share."""
    paths = [os.path.abspath(photograph.path.with_suffix("")) for photograph in photographs]
    common = os.path.commonpath([os.path.dirname(path) for path in paths])
    return [os.path.relpath(path, common) for path in paths]


def _all_splits(names: Sequence[str], poses: np.ndarray) -> Iterator[NameSplit]:
    """Every number in a name, folders included, is of the moment or of the camera; words are of the camera, but for
    those of folders, which may be moments."""
    yield from _number_splits([re.split(r"(\d+)", name) for name in names], poses)
    folders, files = zip(*(os.path.split(name) for name in names))
    if not any(re.search(r"\d", folder) for folder in folders):
        yield NameSplit(poses, tuple(files), tuple(folders))


def _cut_numbers(names: Sequence[str], poses: np.ndarray) -> Iterator[NameSplit]:
    """Of names whose one number has the same digits in all: two numbers, cut at any digit."""
    pieces = [re.split(r"(\d+)", name) for name in names]
    for i in range(1, min(map(len, pieces)), 2):
        widths = {len(own[i]) for own in pieces}
        if len(widths) == 1 and len({own[i] for own in pieces}) > 1:
            for cut in range(1, widths.pop()):
                yield from _number_splits(
                    [[*own[:i], own[i][:cut], "", own[i][cut:], *own[i + 1 :]] for own in pieces], poses
                )


def _number_splits(pieces: Sequence[Sequence[str]], poses: np.ndarray) -> Iterator[NameSplit]:
    """pieces: of each name text, number, text, …; numbers are counted from the end."""
    most = max(map(len, pieces))
    pieces = [[""] * (most - len(own)) + list(own) for own in pieces]
    varying = [i for i in range(1, most, 2) if len({own[i] for own in pieces}) > 1]
    first = pieces[0]
    in_folder = [i for i in varying if os.sep in "".join(first[i + 1 :])]
    several_folders = len({os.path.dirname("".join(own)) for own in pieces}) > 1
    for count in range(1, len(varying) + 1) if len(varying) <= MOST_NUMBERS else (1,):
        for chosen in combinations(varying, count):
            others = [i for i in varying if i not in chosen]
            yield NameSplit(
                poses,
                _labels(["".join("_" if i in chosen else part for i, part in enumerate(own)) for own in pieces]),
                tuple(_moment(own, chosen, others) for own in pieces),
                by_words=(
                    any(CAMERA_WORD.search(first[i - 1]) for i in others)
                    or any(MOMENT_WORD.search(first[i - 1]) for i in chosen)
                )
                and not any(MOMENT_WORD.search(first[i - 1]) for i in others)
                and not any(CAMERA_WORD.search(first[i - 1]) for i in chosen),
                by_folders=others == in_folder and several_folders,
            )


def _moment(pieces: Sequence[str], chosen: Sequence[int], others: Sequence[int]) -> str:
    """The chosen numbers, with what stands between them unless a number of the camera does: 1678901234_133000000."""
    first, last = chosen[0], chosen[-1]
    if any(first < i < last for i in others):
        return "_".join(pieces[i] for i in chosen)
    return "".join(pieces[first : last + 1])


def _labels(names: Sequence[str]) -> tuple[str, ...]:
    """The names without moments, of each only what tells it from the others: its folders, or parts of all of it."""
    for cut in (lambda name: name.split(os.sep)[:-1], lambda name: re.split(r"[\W_]+", name)):
        parts = [[part.strip("_") for part in cut(name)] for name in names]
        if len({len(own) for own in parts}) == 1:
            differ = [i for i in range(len(parts[0])) if len({own[i] for own in parts}) > 1]
            labels = tuple("_".join(own[i] for i in differ if own[i]) for own in parts)
            if len(set(labels)) == len(set(names)):
                return labels
    return tuple(names)
