"""Which camera took each photograph, when, and which of them are used, trained on and held out."""

from __future__ import annotations

import os
import re
from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from datasets.files.errors import SceneError
from datasets.files.natural_order import last_number, natural_order
from datasets.layouts.photograph import LayoutOptions, Photograph

FEWEST = 3  # photographs


def by_folder(photographs: Sequence[Photograph]) -> list[Photograph]:
    """images/left/1.png, images/right/1.png: a camera for each folder, numbered in the order of the folders' names.

    In one folder, left_1.png and right_1.png: a camera for each beginning of the names, if each stands still.
    """
    parents = [os.path.abspath(photograph.path.parent) for photograph in photographs]
    folders = sorted(set(parents), key=natural_order)
    if len(folders) < 2:
        return _by_beginning(photographs)
    names = [os.path.relpath(folder, os.path.commonpath(folders)) for folder in folders]
    groups = {folder: group for group, folder in enumerate(folders)}
    return [replace(p, group=groups[own], folder=names[groups[own]]) for p, own in zip(photographs, parents)]


def _by_beginning(photographs: Sequence[Photograph]) -> list[Photograph]:
    beginnings = [re.sub(r"[\W_]*\d+$", "", photograph.path.stem) for photograph in photographs]
    numbers = {name: number for number, name in enumerate(sorted(set(beginnings), key=natural_order))}
    found = [replace(p, group=numbers[own], folder=own) for p, own in zip(photographs, beginnings)]
    return found if stand_still(found) else list(photographs)


def without_cameras(root: Path, photographs: Sequence[Photograph], options: LayoutOptions) -> list[Photograph]:
    """Those of cameras that are not in options.drop_cameras. SceneError for unknown numbers, or if none is left."""
    dropped, names = set(options.drop_cameras), _camera_names(photographs)
    if dropped and not dropped < set(names):
        known = ", ".join(names.values())
        raise SceneError(f"{root}: scene.drop_cameras", f"some of the cameras {known}", f"{sorted(dropped)}")
    return [photograph for photograph in photographs if photograph.group not in dropped]


def _camera_names(photographs: Sequence[Photograph]) -> dict[int, str]:
    """Camera number -> how messages call it, ascending."""
    folders = {photograph.group: photograph.folder for photograph in photographs}
    return {group: f"{group} ({folder})" if folder else f"{group}" for group, folder in sorted(folders.items())}


def with_times(photographs: Sequence[Photograph], options: LayoutOptions) -> list[Photograph]:
    """All with a time, ascending: the layout's, else the numbers in the names, else evenly spaced.

    Numbers are times if no camera has one twice; cameras in folders of their own count alike.
    """
    known = [photograph.time for photograph in photographs if photograph.time is not None]
    if known and len(known) < len(photographs):
        missing = next(photograph for photograph in photographs if photograph.time is None)
        raise SceneError(missing.path, "a time in every frame or in none", f"none here and {len(known)} elsewhere")
    if known:
        return sorted(photographs, key=lambda p: (p.time, p.name))
    numbers = [last_number(photograph.path.stem) for photograph in photographs]
    of_cameras = {(photograph.group, number) for photograph, number in zip(photographs, numbers)}
    if None not in numbers and len(of_cameras) == len(numbers) and len(set(numbers)) > 1:
        times, how = [number for number in numbers if number is not None], "the numbers in the file names"
    else:
        times, how = [float(index) for index in range(len(photographs))], "evenly spaced, in the order of the names"
    options.log(f"times: {how}; if nothing moves, ablation.static=true leaves time out")
    return sorted((replace(p, time=t) for p, t in zip(photographs, times)), key=lambda p: p.time or 0.0)


def within_limits(root: Path, photographs: Sequence[Photograph], options: LayoutOptions) -> list[Photograph]:
    """Those of at most options.frames different times, evenly spread, from options.first_frame on.

    SceneError for settings that leave fewer than FEWEST.
    """
    times = sorted({photograph.time for photograph in photographs if photograph.time is not None})
    in_use = set(times[options.first_frame :])
    rest = [photograph for photograph in photographs if photograph.time in in_use]
    if stand_still(rest):
        found = [p for group in sorted({p.group for p in rest}) for p in _spread(rest, options.frames, group)]
        found.sort(key=lambda p: (p.time, p.name))
    else:
        found = _spread(rest, options.frames)
    if len(found) < len(rest):
        used = len({photograph.time for photograph in found})
        options.log(f"{used} of {len(times)} times are used, evenly spread (scene.frames={options.frames})")
    if len(found) < FEWEST:
        cut = len(times) - options.first_frame > options.frames
        key, value = ("frames", options.frames) if cut else ("first_frame", options.first_frame)
        raise SceneError(
            f"{root}: scene.{key}",
            f"a number that leaves at least {FEWEST} of {len(photographs)} photographs of {len(times)} times",
            f"{value}, which leaves {len(found)}",
        )
    return found


def _spread(photographs: Sequence[Photograph], count: int, group: int | None = None) -> list[Photograph]:
    """Those of at most `count` times, evenly spread; of one group or all.

    Times that the layout holds out are spread by themselves: of times that alternate, an even choice from both would
    train on one stretch and test on another.
    """
    own = [photograph for photograph in photographs if group is None or photograph.group == group]
    times = {photograph.time for photograph in own}
    trained = {photograph.time for photograph in own if not photograph.test}
    if len(times) <= count:
        return own
    of_training = round(count * len(trained) / len(times))
    kept = {
        listed[i]
        for chosen, number in ((trained, of_training), (times - trained, count - of_training))
        if (listed := sorted(time for time in chosen if time is not None))
        for i in np.linspace(0, len(listed) - 1, max(1, number)).round().astype(int)
    }
    return [photograph for photograph in own if photograph.time in kept]


def stand_still(photographs: Sequence[Photograph]) -> bool:
    """Whether they are by two cameras or more, each of which took several from one place."""
    poses: dict[int, set[bytes]] = defaultdict(set)
    for photograph in photographs:
        poses[photograph.group].add(photograph.camera.world_to_cam.tobytes())
    fewest = min(Counter(photograph.group for photograph in photographs).values(), default=0)
    return len(poses) > 1 and fewest > 1 and all(len(found) == 1 for found in poses.values())


def held_out_names(root: Path, photographs: Sequence[Photograph], options: LayoutOptions) -> tuple[set[str], str]:
    """(names held out, how the split is called in tables)."""
    stated = {photograph.name for photograph in photographs if photograph.test}
    if stated and len(stated) < len(photographs):
        return stated, "the layout's test frames"
    cameras = _camera_names(photographs)
    times = len({photograph.time for photograph in photographs})
    rig = times < len(photographs) or stand_still(photographs)
    if (len(cameras) > 2 and rig) or (len(cameras) > 1 and list(options.test_cameras) != [0]):
        # 0, the default, is the first camera also where a folder counts from 1.
        chosen = sorted({min(cameras) if number == 0 else number for number in options.test_cameras})
        if not set(chosen) < set(cameras):
            known = ", ".join(cameras.values())
            raise SceneError(f"{root}: scene.test_cameras", f"some of the cameras {known}", f"{chosen}")
        names = {photograph.name for photograph in photographs if photograph.group in chosen}
        return names, "camera " + ", ".join(cameras[number] for number in chosen)
    every = options.test_every
    groups = list(cameras)
    held_out = {
        photograph.name
        for number, group in enumerate(groups)  # of two cameras at one time not both
        for photograph in [p for p in photographs if p.group == group][
            (every // 2 + number * every // len(groups)) % every :: every
        ]
    }
    if not held_out:
        held_out = {photographs[len(photographs) // 2].name}
    return held_out, f"every {ordinal(every)} frame"


def ordinal(number: int) -> str:
    """ "2nd", "3rd", "8th"."""
    ending = {1: "st", 2: "nd", 3: "rd"}.get(number % 10, "th") if number % 100 not in (11, 12, 13) else "th"
    return f"{number}{ending}"
