"""Keeps reconstructions, so that seeds, ablations and schedules of a scene share one.

    <cache>/sfm-<hash>/result.npz, result.json, sfm.json (the summary), sfm.png (the picture)

The hash is of everything the result follows from. A folder is written beside its name and renamed: it is whole or it
is not there.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Sequence
from dataclasses import asdict
from importlib import metadata
from pathlib import Path

import numpy as np

from datasets.files.atomic_folder import atomic_folder, write_json
from datasets.files.errors import DataError, read_json
from pipeline.config.schema import InitConfig
from pipeline.data.sfm.photograph import Lens, Photograph, Reconstruction
from pipeline.data.sfm.picture import draw
from pipeline.data.sfm.run import reconstruct
from rasterizer.camera import FARTHEST, Camera

VERSION = 1  # of what this program makes of COLMAP's points
# Settings of InitConfig that come after structure from motion.
_LATER = ("source", "min_points", "sphere_points", "sphere_radius")


def reconstruct_once(
    photographs: Sequence[Photograph], cfg: InitConfig, unit: float, source: Path, cache: Path
) -> tuple[Reconstruction, Path]:
    """`run.reconstruct`, or what it gave before; and the folder that holds it."""
    folder = cache / f"sfm-{fingerprint(photographs, cfg, unit)}"
    if not (folder / "result.json").is_file():
        save(reconstruct(photographs, cfg, unit, source), folder)
    result = load(folder)
    if len(result.points) < cfg.min_points:  # kept by a run that asked for fewer
        raise ValueError(
            f"{folder}: expected at least {cfg.min_points} points (init.min_points), found {len(result.points)}"
        )
    return result, folder


def fingerprint(photographs: Sequence[Photograph], cfg: InitConfig, unit: float) -> str:
    """Twelve hexadecimal digits for photographs, poses and settings."""
    settings = {key: value for key, value in asdict(cfg).items() if key not in _LATER}
    versions = [VERSION, metadata.version("pycolmap")]
    digest = hashlib.blake2b(json.dumps([settings, unit, versions], sort_keys=True).encode(), digest_size=6)
    for photograph in photographs:
        c = photograph.camera
        described = None if c is None else (c.fx, c.fy, c.cx, c.cy, c.world_to_cam.tolist())
        digest.update(repr((photograph.name, photograph.held_out, photograph.image.shape, described)).encode())
        if c is None or not photograph.held_out:  # with its pose known a held-out photograph is not looked at
            digest.update(np.ascontiguousarray(photograph.image))
    return digest.hexdigest()


def save(result: Reconstruction, folder: Path) -> None:
    """Write the folder, whole or not at all. Of two processes that make the same, the first one's stands."""
    with atomic_folder(folder, proof="result.json") as draft:
        np.savez(
            draft / "result.npz",
            points=result.points,
            colors=result.colors,
            errors=result.errors,
            track_lengths=result.track_lengths,
        )
        lenses = {name: _described(lens) for name, lens in result.lenses.items()}
        write_json(
            draft / "result.json",
            {"poses": result.poses, "photographs": result.photographs, "seconds": result.seconds, "lenses": lenses},
        )
        write_json(draft / "sfm.json", result.summary())
        draw(result, draft / "sfm.png")


def load(folder: Path) -> Reconstruction:
    """What `save` kept there; DataError, one line that names the folder, where it is damaged."""
    try:
        rest = read_json(folder / "result.json")
        lenses = {
            name: Lens(Camera(**described["camera"]), described["radial"])
            for name, described in rest.pop("lenses").items()
        }
        with np.load(folder / "result.npz", allow_pickle=False) as arrays:
            return _checked(Reconstruction(**arrays, lenses=lenses, **rest))
    except Exception as error:  # numpy, zipfile and json raise many types for broken files
        what = f"no {error}" if isinstance(error, KeyError) else str(error)
        raise DataError(
            folder,
            "what structure from motion found (result.json, result.npz)",
            f"{what}; delete the folder and run again",
        ) from None


def _checked(found: Reconstruction) -> Reconstruction:
    """The result itself; ValueError where it is not what `save` is given."""
    count = len(found.points)
    for name, kinds, shape in (
        ("points", "f", (count, 3)),
        ("colors", "u", (count, 3)),
        ("errors", "f", (count,)),
        ("track_lengths", "iu", (count,)),
    ):
        array = getattr(found, name)
        if array.dtype.kind not in kinds or array.shape != shape or not np.isfinite(array).all():
            raise ValueError(f"{name} {array.dtype} {array.shape}, or not finite")
    if count == 0 or np.abs(found.points).max() > FARTHEST or found.colors.dtype != np.uint8:
        raise ValueError(f"no points, points beyond {FARTHEST:g}, or colours that are not bytes")
    numbers = (found.seconds, found.photographs, *(lens.radial for lens in found.lenses.values()))
    if found.poses not in ("known", "refined", "estimated") or not all(
        isinstance(number, (int, float)) and math.isfinite(number) for number in numbers
    ):
        raise ValueError(f"poses {found.poses!r}, or seconds, photographs or a lens that are no numbers")
    return found


def _described(lens: Lens) -> dict:
    camera = asdict(lens.camera)
    return {"camera": {**camera, "world_to_cam": camera["world_to_cam"].tolist()}, "radial": lens.radial}
