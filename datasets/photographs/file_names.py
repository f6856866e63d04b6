"""Which camera took each photograph, and when, by the names of files and folders."""

from __future__ import annotations

import os
from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from datasets.files.errors import SceneError
from datasets.files.natural_order import about_even, last_number, natural_order, starts_again
from datasets.photographs.name_splits import find_split
from datasets.photographs.one_instant import are_filmed
from datasets.photographs.photograph import PosedFile
from datasets.source import Log


def by_name(root: Path, photographs: Sequence[PosedFile], log: Log) -> list[PosedFile]:
    """With the camera that took each, numbered from 0 in the order of its name; all as they are if names tell nothing.

    Of all ways to read the names the poses decide (name_splits.py). Folders that share no moments are cameras, too.
    """
    split, why = find_split(root, photographs)
    if split is None:
        parents = [os.path.abspath(photograph.path.parent) for photograph in photographs]
        if len(set(parents)) == 1:
            return list(photographs)
        common = os.path.commonpath(parents)
        return _grouped(photographs, [os.path.relpath(parent, common) for parent in parents])
    log(f"names: {split}, {why}")
    return _grouped(photographs, split.cameras, split.moments)


def with_times(photographs: Sequence[PosedFile], log: Log) -> list[PosedFile]:
    """All with a time, ascending: the layout's, else the numbers in the names, else evenly spaced for each camera.

    Photographs of one group that are no film (one_instant.py) have one time, 0.

    Numbers are times if no camera has one twice, they are about evenly spaced, and they do not start again while a
    number before them counts on, as fractions of a second do; all cameras count alike.
    """
    known = [photograph.time for photograph in photographs if photograph.time is not None]
    if known and len(known) < len(photographs):
        missing = next(photograph for photograph in photographs if photograph.time is None)
        raise SceneError(missing.path, "a time in every frame or in none", f"none here and {len(known)} elsewhere")
    if known:
        return sorted(photographs, key=lambda p: (p.time, p.name))
    if len({p.group for p in photographs}) == 1 and not are_filmed(photographs):
        log("times: none; the cameras are too far apart for a film's, so that all images are taken as of one instant")
        return [replace(p, time=0.0) for p in photographs]
    moments = [p.path.stem if p.moment is None else p.moment for p in photographs]
    numbers = [last_number(moment) for moment in moments]
    of_cameras = {(photograph.group, number) for photograph, number in zip(photographs, numbers)}
    if (
        len(of_cameras) == len(numbers)
        and about_even(numbers)
        and not any(
            starts_again([m for m, p in zip(moments, photographs) if p.group == group])
            for group in {p.group for p in photographs}
        )
    ):
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
