"""Which camera took each photograph, and when, by the names of files and folders."""

from __future__ import annotations

import os
import re
from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from datasets.files.errors import SceneError
from datasets.files.natural_order import about_even, last_number, natural_order
from datasets.photographs.photograph import PosedFile
from datasets.source import Log

SHARED_NUMBERS = 0.5  # of the camera with the fewest: as many frames of one number make two names two cameras
SAME_PLACE = 1e-6  # of the distance between cameras; two of a car are 1e-2 of its way apart


def by_name(photographs: Sequence[PosedFile]) -> list[PosedFile]:
    """With the camera that took each, numbered from 0 in the order of its name; all as they are if names tell nothing.

    images/left/1.png and images/right/1.png: a camera for each folder. In one folder, left_1.png and right_1.png: one
    for each beginning, if their numbers coincide or each stands still. images/001/left.png or 001_left.png: one for
    each ending, if it stands still or each folder has one time.
    """
    parents = [os.path.abspath(photograph.path.parent) for photograph in photographs]
    folders = sorted(set(parents), key=natural_order)
    stems = [photograph.path.stem for photograph in photographs]
    if len(folders) > 1:
        names = [os.path.relpath(parent, os.path.commonpath(folders)) for parent in parents]
        if _are_moments(photographs, names, stems):
            return _grouped(photographs, stems, names)
        return _grouped(photographs, names)
    parts = [re.fullmatch(r"(\d+)[\W_]+(.*\w.*)", stem) for stem in stems]
    moments, endings = [part[1] for part in parts if part], [part[2] for part in parts if part]
    if len(moments) == len(stems) and _are_moments(photographs, moments, endings):
        return _grouped(photographs, endings, moments)
    beginnings = [re.sub(r"[\W_]*\d+$", "", stem) for stem in stems]
    found = _grouped(photographs, beginnings)
    return found if stand_still(found) or _coincide(beginnings, stems) else list(photographs)


def with_times(photographs: Sequence[PosedFile], log: Log) -> list[PosedFile]:
    """All with a time, ascending: the layout's, else the numbers in the names, else evenly spaced for each camera.

    Numbers are times if no camera has one twice and they are about evenly spaced; all cameras count alike.
    """
    known = [photograph.time for photograph in photographs if photograph.time is not None]
    if known and len(known) < len(photographs):
        missing = next(photograph for photograph in photographs if photograph.time is None)
        raise SceneError(missing.path, "a time in every frame or in none", f"none here and {len(known)} elsewhere")
    if known:
        return sorted(photographs, key=lambda p: (p.time, p.name))
    numbers = [last_number(p.path.stem if p.moment is None else p.moment) for p in photographs]
    of_cameras = {(photograph.group, number) for photograph, number in zip(photographs, numbers)}
    if len(of_cameras) == len(numbers) and about_even(numbers):
        times, how = [number for number in numbers if number is not None], "the numbers in the file names"
    else:
        counted: Counter[int] = Counter()
        times = []
        for photograph in photographs:
            times.append(float(counted[photograph.group]))
            counted[photograph.group] += 1
        how = "evenly spaced, in the order of the names" + (" of each camera" if len(counted) > 1 else "")
    log(f"times: {how}; if nothing moves, ablation.static=true leaves time out")
    return sorted((replace(p, time=t) for p, t in zip(photographs, times)), key=lambda p: p.time or 0.0)


def stand_still(photographs: Sequence[PosedFile]) -> bool:
    """Whether they are by two cameras or more, each of which took several from one place."""
    poses: dict[int, set[bytes]] = defaultdict(set)
    for photograph in photographs:
        poses[photograph.group].add(photograph.camera.world_to_cam.tobytes())
    fewest = min(Counter(photograph.group for photograph in photographs).values(), default=0)
    return len(poses) > 1 and fewest > 1 and all(len(found) == 1 for found in poses.values())


def _grouped(
    photographs: Sequence[PosedFile], cameras: Sequence[str], moments: Sequence[str] | None = None
) -> list[PosedFile]:
    numbers = {name: number for number, name in enumerate(sorted(set(cameras), key=natural_order))}
    times: Sequence[str | None] = moments or [None] * len(photographs)
    return [
        replace(p, group=numbers[own], folder=own, moment=moment)
        for p, own, moment in zip(photographs, cameras, times, strict=True)
    ]


def _are_moments(photographs: Sequence[PosedFile], moments: Sequence[str], cameras: Sequence[str]) -> bool:
    """Whether names are moments that several cameras saw: each once, from where it always is, or all at one time."""
    if len(set(zip(moments, cameras))) < len(photographs) or min(Counter(cameras).values()) < 2:
        return False
    of_moment: dict[str, list[PosedFile]] = defaultdict(list)
    for photograph, moment in zip(photographs, moments):
        of_moment[moment].append(photograph)
    if max(map(len, of_moment.values())) < 2:
        return False
    times = [{photograph.time for photograph in found} for found in of_moment.values()]
    if None not in times[0]:
        return all(len(found) == 1 for found in times) and len(set().union(*times)) > 1
    return _in_place(photographs, cameras) and not _in_place(photographs, moments)


def _in_place(photographs: Sequence[PosedFile], cameras: Sequence[str]) -> bool:
    """Whether each camera stays where it is, compared with the distances to others."""
    places: dict[str, list[np.ndarray]] = defaultdict(list)
    for photograph, camera in zip(photographs, cameras):
        places[camera].append(photograph.camera.position)
    moved = max(float(np.ptp(np.stack(found), axis=0).max()) for found in places.values())
    apart = float(np.ptp(np.stack([np.mean(found, axis=0) for found in places.values()]), axis=0).max())
    return moved <= SAME_PLACE * apart


def _coincide(beginnings: Sequence[str], stems: Sequence[str]) -> bool:
    """Whether names with these beginnings end in the same numbers, as those of cameras that filmed together do."""
    numbers: dict[str, set[float | None]] = defaultdict(set)
    for beginning, stem in zip(beginnings, stems):
        numbers[beginning].add(last_number(stem[len(beginning) :]))
    found = list(numbers.values())
    if len(found) < 2 or any(None in own for own in found):
        return False
    fewest = min(map(len, found))
    return fewest > 1 and len(set.intersection(*found)) >= SHARED_NUMBERS * fewest
