"""Runs COLMAP on photographs, in a process of its own (see colmap.py), and says in one line what they do not give."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from PIL import Image

from pipeline.config.schema import InitConfig
from pipeline.data.sfm.job import Found, Request, Shot, failure, read_found, write_request
from pipeline.data.sfm.photograph import Lens, Photograph, Reconstruction
from pipeline.runs.provenance import PROJECT_ROOT
from rasterizer.camera import Camera


def reconstruct(photographs: Sequence[Photograph], cfg: InitConfig, unit: float, source: Path) -> Reconstruction:
    """Points, and poses where the photographs have none. The result is the same for the same `cfg.seed`.

    unit: of distance, world units (ignored without poses: such a world has no unit). source: where the photographs are
    from, for messages. Raises ValueError, one line, for photographs that do not suffice.
    """
    used = [p for p in photographs if not p.held_out]
    if len(used) < 2:
        raise ValueError(f"{source}: expected at least 2 training cameras for structure from motion, found {len(used)}")
    started = time.perf_counter()
    with tempfile.TemporaryDirectory(prefix="sfm-") as temporary:
        folder = Path(temporary)
        (folder / "images").mkdir()
        known = all(p.camera is not None for p in photographs)
        needed = used if known else photographs  # with a known pose a held-out photograph has no part in this at all
        for photograph in needed:
            Image.fromarray(photograph.image).save(folder / "images" / f"{photograph.name}.png", compress_level=1)
        write_request(
            folder,
            Request(
                photographs=[_shot(p) for p in needed],
                unit=unit,
                seed=cfg.seed,
                max_features=cfg.max_features,
                max_error_px=cfg.max_error_px,
                min_track=cfg.min_track,
                min_angle_deg=cfg.min_angle_deg,
                max_distance=cfg.max_distance,
                refine_poses=cfg.refine_poses,
                shared_intrinsics=cfg.shared_intrinsics,
            ),
        )
        found = _run(folder, source)
    if len(found.points) < cfg.min_points:
        raise ValueError(
            f"{source}: expected at least {cfg.min_points} points from structure from motion (init.min_points), found "
            f"{len(found.points)}; photographs with more texture or overlap give more, as do a smaller scene.downscale, "
            "init.max_error_px above, init.min_track or init.min_angle_deg below what they are; init.source=random does "
            "without"
        )
    poses = "estimated" if not known else "refined" if cfg.refine_poses else "known"
    sizes = {p.name: p.image.shape for p in needed}
    lenses = {name: _lens(found.lenses[name], sizes[name]) for name in found.lenses}
    if poses == "known":  # as they were given, not as they came back
        lenses = {p.name: Lens(p.camera) for p in used}
    return Reconstruction(
        found.points,
        found.colors,
        found.errors,
        found.track_lengths,
        lenses,
        poses,
        len(used),
        time.perf_counter() - started,
    )


def _run(folder: Path, source: Path) -> Found:
    done = subprocess.run(
        [sys.executable, "-m", "pipeline.data.sfm.colmap", str(folder)],
        cwd=PROJECT_ROOT,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    if line := failure(folder):
        raise ValueError(f"{source}: {line}")
    if done.returncode != 0:
        last = (done.stderr.strip().splitlines() or ["no message"])[-1]
        raise ValueError(
            f"{source}: expected structure from motion to end well, found COLMAP ended with status "
            f"{done.returncode}: {last}"
        )
    return read_found(folder)


def _shot(photograph: Photograph) -> Shot:
    camera = photograph.camera
    described = (
        None
        if camera is None
        else {"intrinsics": [camera.fx, camera.fy, camera.cx, camera.cy], "world_to_cam": camera.world_to_cam.tolist()}
    )
    return Shot(photograph.name, described, photograph.held_out)


def _lens(found: dict, shape: tuple[int, ...]) -> Lens:
    return Lens(Camera(shape[1], shape[0], *found["intrinsics"], found["world_to_cam"]), found["radial"])
