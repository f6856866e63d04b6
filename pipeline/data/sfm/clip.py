"""reconstruct_clip(): cameras of the frames of clips, in two passes, so that what moves does not mislead them.

The first pass uses all features. What disagrees with the cameras it finds is marked (moving_masks.py). The second pass
drops the matches on it, verifies the others again, and starts from the lens of the first.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import combinations, groupby
from pathlib import Path

import numpy as np

from datasets.source import Photograph
from pipeline.config.schema import InitConfig
from pipeline.data.sfm.job import ARRAYS, WHAT_TO_DRIVE, WHAT_TO_OVERLAP, ColmapResult, SfmError, write_request
from pipeline.data.sfm.moving_masks import moving_masks
from pipeline.data.sfm.reconstruction import Reconstruction
from pipeline.data.sfm.run import cameras_of, job_folder, request_for, run_colmap, write_masks

LEAST_REGISTERED = 0.8  # of the frames
FIRST_PASS = 0.3  # of the frames: enough to mark what moves
LEAST_OF_LENS = 0.5  # of the frames of each camera, where there are several
KEPT_BY_SECOND = 0.95  # of the first pass's cameras; where the second finds fewer, its masks took too much
# Frames matched with each frame, by their distance in time: near ones overlap most, far ones keep the path from
# drifting and find a place that is seen again.
DISTANCES = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256)
# Of two cameras: each frame with those of the other at the same time and so many frames off, when what moves is nearly
# the same, and some frames with some at any time, as one camera may see now what another saw before.
AROUND = (-8, -2, 0, 2, 8)
FEW = 3  # cameras: of more, frames at the same time and the spread ones are enough, as each is seen by many
SPREAD = 10


def reconstruct_clip(
    photographs: Sequence[Photograph],
    cfg: InitConfig,
    source: Path,
    log: Callable[[str], None],
    observations: bool = False,
) -> Reconstruction:
    """Cameras and points from frames in order of time; world units are arbitrary.

    photographs: those of one lens one after another, of several cameras on one clock. Frames whose camera is not found
    are missing in `cameras`. ValueError, one line with what to film instead, if that is more than a fifth of them.
    """
    started = time.perf_counter()
    names = [photograph.name for photograph in photographs]
    lenses = by_lens(photographs)
    refused: ValueError | None = None
    with job_folder(photographs) as folder:
        request = replace(request_for(photographs, cfg, 1.0), pairs=pairs_of(lenses), least_registered=FIRST_PASS)
        request = replace(request, observations=observations)
        if len(lenses) > 1 and cfg.shared_intrinsics:
            request = replace(request, lenses=[[p.name for p in lens] for lens in lenses])
        write_request(folder, request)
        found = first = run_colmap(folder, source)
        log(f"sfm: first pass, {len(first.cameras)} of {len(names)} frames registered")
        masks: dict[str, np.ndarray] = {}
        for lens in lenses:  # flow is measured between frames of one camera
            masks |= moving_masks(lens, cameras_of(first, photographs), first.points)
        if any(mask.any() for mask in masks.values()):
            write_masks(folder, masks)
            write_request(folder, replace(request, masked=True, intrinsics=_intrinsics(first, lenses)))
            second = None
            try:
                second = run_colmap(folder, source)
            except ValueError as error:  # the masks took what the first pass stood on
                refused = error
                if isinstance(error, SfmError) and error.camera_turns:
                    raise  # moving objects had misled the first pass
            share = float(np.mean([mask.mean() for mask in masks.values()]))
            registered = "too few" if second is None else len(second.cameras)
            log(
                f"sfm: second pass, without the {share:.0%} of the pictures that moves, {registered} of "
                f"{len(names)} frames registered"
            )
            if second is not None and len(second.cameras) >= KEPT_BY_SECOND * len(first.cameras):
                found = second
            else:
                log("sfm: the first pass is used, which found more")
    if len(lenses) > 1:
        _refuse_missing(found, lenses, source)
    if len(found.cameras) < LEAST_REGISTERED * len(names):
        if refused is not None:
            raise refused
        advice = WHAT_TO_DRIVE if found.drives else WHAT_TO_OVERLAP
        raise ValueError(
            f"{source}: expected to find the camera of {LEAST_REGISTERED:.0%} of {len(names)} frames, found that of "
            f"{len(found.cameras)}: too little overlap; {advice}"
        )
    if len(found.points) < cfg.min_points:
        raise ValueError(
            f"{source}: expected at least {cfg.min_points} points from structure from motion (init.min_points), found "
            f"{len(found.points)}: too little texture, or a camera that hardly moves; walk sideways while filming"
        )
    facts = {"poses": "estimated", "photographs": len(names), "seconds": time.perf_counter() - started}
    return Reconstruction(
        **{**{name: getattr(found, name) for name in ARRAYS}, **facts, "cameras": cameras_of(found, photographs)}
    )


def _intrinsics(first: ColmapResult, lenses: Sequence[Sequence[Photograph]]) -> dict[str, list[float]]:
    """Photograph -> [focal, cx, cy, k] of its lens, as the first pass found it."""
    found: dict[str, list[float]] = {}
    for lens in lenses:
        record = next((first.cameras[p.name] for p in lens if p.name in first.cameras), None)
        if record is not None:
            focal, _, cx, cy = record["intrinsics"]
            found |= {p.name: [focal, cx, cy, record["radial"]] for p in lens}
    return found


def _refuse_missing(found: ColmapResult, lenses: Sequence[Sequence[Photograph]], source: Path) -> None:
    """ValueError for a camera of which too few frames were found: it does not see what the others see."""
    for lens in lenses:
        count = sum(p.name in found.cameras for p in lens)
        if count < LEAST_OF_LENS * len(lens):
            raise ValueError(
                f"{source}: expected to find {lens[0].lens} among the other cameras, found {count} of {len(lens)} of "
                "its frames; let all cameras film the same things, from places that are not far apart, or leave it "
                "out (scene.drop_cameras)"
            )


def by_lens(photographs: Sequence[Photograph]) -> list[list[Photograph]]:
    """The photographs of each camera; those of one follow one another."""
    return [list(group) for _, group in groupby(photographs, key=lambda photograph: photograph.lens)]


def pairs_of(lenses: Sequence[Sequence[Photograph]]) -> list[list[str]]:
    """Names of the photographs to match, in order of time for each camera."""
    pairs = []
    for lens in lenses:
        names = [photograph.name for photograph in lens]
        pairs += [[a, b] for d in DISTANCES for a, b in zip(names, names[d:])]
    for one, other in combinations(lenses, 2):
        around = AROUND if len(lenses) <= FEW else (0,)
        pairs += [[one[i].name, other[j].name] for i, j in sorted(_between(one, other, around))]
    return pairs


def _between(one: Sequence[Photograph], other: Sequence[Photograph], around: Sequence[int]) -> set[tuple[int, int]]:
    """Places of the photographs to match of two cameras. around: frames from the nearest in time."""
    times = np.array([[abs(a.time - b.time) for b in other] for a in one])
    nearest = [(i, int(j)) for i, j in enumerate(times.argmin(axis=1))]
    nearest += [(int(i), j) for j, i in enumerate(times.argmin(axis=0))]
    near = {(i, j + d) for i, j in nearest for d in around if 0 <= j + d < len(other)}
    ends = [np.unique(np.linspace(0, len(lens) - 1, SPREAD).round().astype(int)) for lens in (one, other)]
    return near | {(int(i), int(j)) for i in ends[0] for j in ends[1]}
