"""reconstruct_clip(): cameras of the frames of one clip, in two passes, so that what moves does not mislead them.

The first pass uses all features. What disagrees with the cameras it finds is marked (moving_masks.py). The second pass
drops the matches on it, verifies the others again, and starts from the lens of the first.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

from pipeline.config.schema import InitConfig
from pipeline.data.sfm.job import ColmapResult, write_request
from pipeline.data.sfm.moving_masks import moving_masks
from pipeline.data.sfm.photograph import CalibratedCamera, Photograph, Reconstruction
from pipeline.data.sfm.run import calibrated, request_for, run_colmap

# Frames matched with each frame, by their distance in time: near ones overlap most, far ones keep the path from
# drifting and find a place that is seen again.
DISTANCES = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256)
LEAST_REGISTERED = 0.8  # of the frames
FIRST_PASS = 0.3  # of the frames: enough to mark what moves
KEPT_BY_SECOND = 0.95  # of the first pass's cameras; where the second finds fewer, its masks took too much


def reconstruct_clip(
    photographs: Sequence[Photograph], cfg: InitConfig, source: Path, log: Callable[[str], None]
) -> Reconstruction:
    """Cameras and points from frames in order of time, all of one lens; world units are arbitrary.

    Frames whose camera is not found are missing in `cameras`. ValueError, one line with what to film instead, if that
    is more than a fifth of them.
    """
    started = time.perf_counter()
    names = [photograph.name for photograph in photographs]
    pairs = [[a, b] for d in DISTANCES for a, b in zip(names, names[d:])]
    sizes = {p.name: p.image.shape for p in photographs}
    with tempfile.TemporaryDirectory(prefix="sfm-") as temporary:
        folder = Path(temporary)
        (folder / "images").mkdir()
        (folder / "masks").mkdir()
        for photograph in photographs:
            Image.fromarray(photograph.image).save(folder / "images" / f"{photograph.name}.png", compress_level=1)
        request = replace(request_for(photographs, cfg, 1.0), pairs=pairs, least_registered=FIRST_PASS)
        write_request(folder, request)
        found = first = run_colmap(folder, source)
        log(f"sfm: first pass, {len(first.cameras)} of {len(names)} frames registered")
        masks = moving_masks(photographs, _cameras(first, sizes), first.points)
        if any(mask.any() for mask in masks.values()):
            for name, mask in masks.items():
                np.save(folder / "masks" / f"{name}.npy", mask)
            lens = next(iter(first.cameras.values()))
            focal, _, cx, cy = lens["intrinsics"]
            write_request(folder, replace(request, masked=True, intrinsics=[focal, cx, cy, lens["radial"]]))
            second = second_pass(folder, source)
            share = float(np.mean([mask.mean() for mask in masks.values()]))
            registered = 0 if second is None else len(second.cameras)
            log(
                f"sfm: second pass, without the {share:.0%} of the pictures that moves, {registered} of "
                f"{len(names)} frames registered"
            )
            if second is not None and registered >= KEPT_BY_SECOND * len(first.cameras):
                found = second
            else:
                log("sfm: the first pass is used, which found more")
    if len(found.cameras) < LEAST_REGISTERED * len(names):
        raise ValueError(
            f"{source}: expected to find the camera of {LEAST_REGISTERED:.0%} of {len(names)} frames, found that of "
            f"{len(found.cameras)}: too little overlap; film slowly, with texture in view all the time, and so that "
            "every part of the scene is seen from several places"
        )
    if len(found.points) < cfg.min_points:
        raise ValueError(
            f"{source}: expected at least {cfg.min_points} points from structure from motion (init.min_points), found "
            f"{len(found.points)}: too little texture, or a camera that hardly moves; walk sideways while filming"
        )
    return Reconstruction(
        found.points,
        found.colors,
        found.errors,
        found.track_lengths,
        _cameras(found, sizes),
        "estimated",
        len(names),
        time.perf_counter() - started,
    )


def second_pass(folder: Path, source: Path) -> ColmapResult | None:
    """None where it finds too few cameras: the masks took what the first pass stood on."""
    try:
        return run_colmap(folder, source)
    except ValueError:
        return None


def _cameras(found: ColmapResult, sizes: dict[str, tuple[int, ...]]) -> dict[str, CalibratedCamera]:
    return {name: calibrated(record, sizes[name]) for name, record in found.cameras.items()}
