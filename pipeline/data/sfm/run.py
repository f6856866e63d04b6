"""reconstruct(): runs COLMAP on photographs in a separate process (colmap.py) and checks its result."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from PIL import Image

from datasets.source import Photograph
from pipeline.config.schema import InitConfig
from pipeline.data.sfm.job import (
    ARRAYS,
    ColmapResult,
    PhotographRecord,
    Request,
    SfmError,
    image_file,
    read_error,
    read_result,
    write_request,
)
from pipeline.data.sfm.reconstruction import CalibratedCamera, Reconstruction
from pipeline.runs.provenance import PROJECT_ROOT
from rasterizer.camera import Camera


class TooFewPoints(ValueError):
    """Structure from motion has not found init.min_points."""


@dataclass(frozen=True)
class Matching:
    """Which photographs with poses are matched, and where; the default is all with all, everywhere."""

    pairs: Sequence[Sequence[str]] | None = None  # names; None: all with all
    ignored: Mapping[str, np.ndarray] = field(default_factory=dict)  # name -> (H, W) bool: pixels without a match
    in_order: bool = False  # one camera took them one after another: what moves has no match either


def reconstruct(
    photographs: Sequence[Photograph],
    cfg: InitConfig,
    unit: float,
    source: Path,
    observations: bool = False,
    matching: Matching | None = None,
) -> Reconstruction:
    """Points, and poses if the photographs have none; deterministic.

    unit: world units per normalised unit, for the farthest points; ignored without poses. source: the photographs'
    folder, for messages. observations: whether the result has them. matching: with poses only. Raises ValueError of
    one line if the photographs do not suffice.
    """
    used = [p for p in photographs if not p.held_out]
    if len(used) < 2:
        raise ValueError(f"{source}: expected at least 2 training cameras for structure from motion, found {len(used)}")
    started = time.perf_counter()
    known = all(p.camera is not None for p in photographs)
    needed = used if known else photographs  # a held-out photograph with known pose is not used
    with job_folder(needed) as folder:
        request = replace(request_for(needed, cfg, unit), observations=observations)
        found = _with(matching or Matching(), request, needed, folder, source)
    if len(found.points) < cfg.min_points:
        raise TooFewPoints(
            f"{source}: expected at least {cfg.min_points} points from structure from motion (init.min_points), found "
            f"{len(found.points)}; more texture or overlap gives more, as does a smaller scene.downscale; "
            "init.source=random needs none"
        )
    poses = "estimated" if not known else "refined" if cfg.refine_poses else "known"
    cameras = cameras_of(found, needed)
    if poses == "known":  # exactly as given, without rounding by COLMAP
        cameras = {p.name: CalibratedCamera(p.camera) for p in used if p.camera is not None}
    facts = {"poses": poses, "photographs": len(used), "seconds": time.perf_counter() - started}
    return Reconstruction(**{**{name: getattr(found, name) for name in ARRAYS}, **facts, "cameras": cameras})


def _with(
    matching: Matching, request: Request, photographs: Sequence[Photograph], folder: Path, source: Path
) -> ColmapResult:
    """COLMAP's result. Where matches are left out, they are in a second pass, as the masks need the first's points."""
    if matching.pairs is not None:
        request = replace(request, pairs=[list(pair) for pair in matching.pairs])
    write_request(folder, request)
    found = run_colmap(folder, source)
    ignored = {name: mask for name, mask in matching.ignored.items() if mask.any()}
    if matching.in_order and len(found.points):
        from pipeline.data.sfm.moving_masks import moving_masks  # imports OpenCV

        moving = moving_masks(photographs, cameras_of(found, photographs), found.points)
        ignored |= {name: mask | ignored.get(name, False) for name, mask in moving.items() if mask.any()}
    if not ignored:
        return found
    write_masks(folder, ignored)
    write_request(folder, replace(request, masked=True))
    return run_colmap(folder, source)


def write_masks(folder: Path, masks: Mapping[str, np.ndarray]) -> None:
    """Into a job folder: name -> (H, W) bool, True where matches are dropped in a pass with Request.masked."""
    (folder / "masks").mkdir(exist_ok=True)
    for name, mask in masks.items():
        np.save(folder / "masks" / f"{name}.npy", mask)


@contextmanager
def job_folder(photographs: Sequence[Photograph]) -> Iterator[Path]:
    """A temporary folder with the images of a job."""
    with tempfile.TemporaryDirectory(prefix="sfm-") as temporary:
        images = Path(temporary) / "images"
        images.mkdir()
        for photograph in photographs:
            Image.fromarray(photograph.image).save(images / image_file(photograph.name), compress_level=1)
        yield images.parent


def request_for(photographs: Sequence[Photograph], cfg: InitConfig, unit: float) -> Request:
    """The request for a first and only pass over all pairs."""
    return Request(
        photographs=[_record(p) for p in photographs],
        unit=unit,
        max_features=cfg.max_features,
        refine_poses=cfg.refine_poses,
        shared_intrinsics=cfg.shared_intrinsics,
    )


def run_colmap(folder: Path, source: Path) -> ColmapResult:
    """Runs the COLMAP process on a job folder; ValueError with its error."""
    done = subprocess.run(
        [sys.executable, "-m", "pipeline.data.sfm.colmap", str(folder)],
        cwd=PROJECT_ROOT,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    if error := read_error(folder):
        raise SfmError(f"{source}: {error}", error.camera_turns)
    if done.returncode != 0:
        last = (done.stderr.strip().splitlines() or ["no message"])[-1]
        raise ValueError(
            f"{source}: expected structure from motion to succeed, found COLMAP ended with status "
            f"{done.returncode}: {last}"
        )
    return read_result(folder)


def _record(photograph: Photograph) -> PhotographRecord:
    camera = photograph.camera
    described = (
        None
        if camera is None
        else {"intrinsics": [camera.fx, camera.fy, camera.cx, camera.cy], "world_to_cam": camera.world_to_cam.tolist()}
    )
    return PhotographRecord(photograph.name, described, photograph.held_out)


def cameras_of(found: ColmapResult, photographs: Sequence[Photograph]) -> dict[str, CalibratedCamera]:
    """The cameras of COLMAP's result, at the size of their photographs."""
    shapes, cameras = {p.name: p.image.shape for p in photographs}, {}
    for name, record in found.cameras.items():
        (height, width, _), (fx, fy, cx, cy) = shapes[name], record["intrinsics"]
        camera = Camera(width, height, fx, fy, cx, cy, record["world_to_cam"])
        cameras[name] = CalibratedCamera(camera, record["radial"])
    return cameras
