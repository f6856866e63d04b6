"""Which photographs are used, trained on and held out, by their cameras and times."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from datasets.files.errors import SceneError
from datasets.files.natural_order import end_numbers
from datasets.photographs.file_names import stand_still
from datasets.photographs.photograph import PosedFile
from datasets.settings import SceneConfig
from datasets.source import Log
from datasets.validation import ordinal

FEWEST = 3  # photographs


def without_cameras(root: Path, photographs: Sequence[PosedFile], cfg: SceneConfig) -> list[PosedFile]:
    """Those of cameras that are not in scene.drop_cameras. SceneError for unknown numbers, or if none is left."""
    dropped, names = set(cfg.drop_cameras), _camera_names(photographs)
    if dropped and not dropped < set(names):
        known = ", ".join(names.values())
        raise SceneError(f"{root}: scene.drop_cameras", f"some of the cameras {known}", f"{sorted(dropped)}")
    return [photograph for photograph in photographs if photograph.group not in dropped]


def _camera_names(photographs: Sequence[PosedFile]) -> dict[int, str]:
    """Camera number -> how messages call it, ascending."""
    folders = {photograph.group: photograph.folder for photograph in photographs}
    return {group: f"{group} ({folder})" if folder else f"{group}" for group, folder in sorted(folders.items())}


def within_limits(root: Path, photographs: Sequence[PosedFile], cfg: SceneConfig, log: Log) -> list[PosedFile]:
    """Those of at most scene.frames different times, evenly spread, from scene.first_frame on.

    SceneError for settings that leave fewer than FEWEST.
    """
    times = sorted({photograph.time for photograph in photographs if photograph.time is not None})
    in_use = set(times[cfg.first_frame :])
    rest = [photograph for photograph in photographs if photograph.time in in_use]
    if stand_still(rest):
        found = [p for group in sorted({p.group for p in rest}) for p in _spread(rest, cfg.frames, group)]
        found.sort(key=lambda p: (p.time, p.name))
    else:
        found = _spread(rest, cfg.frames)
    if len(found) < len(rest):
        used = len({photograph.time for photograph in found})
        log(f"{used} of {len(times)} times are used, evenly spread (scene.frames={cfg.frames})")
    if len(found) < FEWEST:
        cut = len(times) - cfg.first_frame > cfg.frames
        key, value = ("frames", cfg.frames) if cut else ("first_frame", cfg.first_frame)
        raise SceneError(
            f"{root}: scene.{key}",
            f"a number that leaves at least {FEWEST} of {len(photographs)} photographs of {len(times)} times",
            f"{value}, which leaves {len(found)}",
        )
    return found


def _spread(photographs: Sequence[PosedFile], count: int, group: int | None = None) -> list[PosedFile]:
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


def held_out_names(root: Path, photographs: Sequence[PosedFile], cfg: SceneConfig) -> tuple[set[str], str]:
    """(names held out, how the split is called in tables). SceneError for settings that hold nothing out."""
    times = len({photograph.time for photograph in photographs})
    chosen_cameras = cfg.test_every == 0 or list(cfg.test_cameras) != [0]
    if chosen_cameras and times == 1 and len(_camera_names(photographs)) == 1:
        photographs = _one_camera_each(photographs)
    cameras = _camera_names(photographs)
    if chosen_cameras and len(cameras) == 1:
        key, found = ("every", "0") if cfg.test_every == 0 else ("cameras", f"{list(cfg.test_cameras)}")
        expected = "at least 2" if cfg.test_every == 0 else "[0]"
        raise SceneError(f"{root}: scene.test_{key}", f"{expected} for photographs by one camera", found)
    stated = {photograph.name for photograph in photographs if photograph.test}
    if stated and len(stated) < len(photographs) and not chosen_cameras:
        return stated, "the layout's test frames"
    rig = times < len(photographs) or stand_still(photographs)
    if (len(cameras) > 2 and rig) or chosen_cameras:
        # 0, the default, is the first camera also where a folder counts from 1.
        chosen = sorted({min(cameras) if number == 0 else number for number in cfg.test_cameras})
        if not set(chosen) < set(cameras):
            known = ", ".join(cameras.values())
            raise SceneError(f"{root}: scene.test_cameras", f"some of the cameras {known}", f"{chosen}")
        names = {photograph.name for photograph in photographs if photograph.group in chosen}
        return names, "camera " + ", ".join(cameras[number] for number in chosen)
    every = cfg.test_every
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


def _one_camera_each(photographs: Sequence[PosedFile]) -> list[PosedFile]:
    """Of one instant every photograph is by a camera of its own."""
    numbers = end_numbers([photograph.path.stem for photograph in photographs])
    return [replace(p, group=number, folder=p.path.stem) for p, number in zip(photographs, numbers, strict=True)]
