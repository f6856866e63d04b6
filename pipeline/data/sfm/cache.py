"""Cache of reconstructions, shared by all runs of a scene.

    <cache>/sfm-<hash>/result.npz, result.json, sfm.json (summary), sfm.png (plot)

The hash covers everything that determines the result. Folders are written atomically.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict
from importlib import metadata
from pathlib import Path

import numpy as np

from datasets.files.atomic_write import atomic_folder, write_json
from datasets.files.errors import DataError, read_json
from datasets.source import Photograph
from pipeline.config.schema import InitConfig
from pipeline.data.sfm.clip import reconstruct_clip
from pipeline.data.sfm.job import ARRAYS
from pipeline.data.sfm.plot import plot_reconstruction
from pipeline.data.sfm.reconstruction import CalibratedCamera, Reconstruction
from pipeline.data.sfm.run import Matching, reconstruct
from rasterizer.camera import MAX_DISTANCE, Camera

VERSION = 1  # to be increased by every change of this project that alters the result
CLIP_VERSION = 1  # the same for the two passes over a clip
# Settings of InitConfig that do not affect structure from motion.
_UNRELATED = ("source", "min_points", "sphere_points", "lidar_points", "lidar_velocities")


def reconstruct_cached(
    photographs: Sequence[Photograph],
    cfg: InitConfig,
    unit: float,
    source: Path,
    cache: Path,
    observations: bool = False,
    clip_log: Callable[[str], None] | None = None,
    matching: Matching | None = None,
) -> tuple[Reconstruction, Path]:
    """The result of `run.reconstruct` and its folder, made if it is not in the cache.

    clip_log: for frames of clips, whose result is that of `clip.reconstruct_clip` with this log. matching: of
    photographs with poses. ValueError for fewer
    points than init.min_points, which may have been smaller when they were written.
    """
    clip = None if clip_log is None else CLIP_VERSION
    folder = cache / f"sfm-{fingerprint(photographs, cfg, unit, clip, observations, matching)}"
    if not (folder / "result.json").is_file():
        if clip_log is not None:
            save(reconstruct_clip(photographs, cfg, source, clip_log, observations), folder)
        else:
            save(reconstruct(photographs, cfg, unit, source, observations, matching), folder)
    result = load(folder)
    if len(result.points) < cfg.min_points:
        raise ValueError(
            f"{folder}: expected at least {cfg.min_points} points (init.min_points), found {len(result.points)}"
        )
    return result, folder


def fingerprint(
    photographs: Sequence[Photograph],
    cfg: InitConfig,
    unit: float,
    clip: int | None = None,
    observations: bool = False,
    matching: Matching | None = None,
) -> str:
    """Hash of photographs, poses, settings and versions: twelve hexadecimal digits. clip: CLIP_VERSION for a clip."""
    settings = {key: value for key, value in asdict(cfg).items() if key not in _UNRELATED}
    versions = [VERSION, metadata.version("pycolmap"), *([] if clip is None else [clip])]
    versions += ["observations"] if observations else []
    digest = hashlib.blake2b(json.dumps([settings, unit, versions], sort_keys=True).encode(), digest_size=6)
    for photograph in photographs:
        c = photograph.camera
        described = None if c is None else (c.fx, c.fy, c.cx, c.cy, c.world_to_cam.tolist())
        digest.update(repr((photograph.name, photograph.held_out, photograph.image.shape, described)).encode())
        if photograph.lens:
            digest.update(repr((photograph.lens, photograph.time)).encode())
        if c is None or not photograph.held_out:  # a held-out photograph with known pose is not used
            digest.update(np.ascontiguousarray(photograph.image).data)
    if matching is not None:
        digest.update(repr((matching.pairs, matching.in_order)).encode())
        for name, mask in matching.ignored.items():
            digest.update(name.encode() + np.packbits(mask).tobytes())
    return digest.hexdigest()


def save(result: Reconstruction, folder: Path) -> None:
    """Writes the folder atomically."""
    with atomic_folder(folder, marker="result.json") as temporary:
        arrays = {name: getattr(result, name) for name in ARRAYS}
        np.savez(temporary / "result.npz", **{name: array for name, array in arrays.items() if array is not None})
        cameras = {name: _camera_json(found) for name, found in result.cameras.items()}
        write_json(
            temporary / "result.json",
            {"poses": result.poses, "photographs": result.photographs, "seconds": result.seconds, "lenses": cameras},
            indent=1,
        )
        write_json(temporary / "sfm.json", result.summary(), indent=1)
        plot_reconstruction(result, temporary / "sfm.png")


def load(folder: Path) -> Reconstruction:
    """The reconstruction that `save` wrote; DataError if the folder is damaged."""
    try:
        content = read_json(folder / "result.json")
        cameras = {
            name: CalibratedCamera(Camera(**record["camera"]), record["radial"])
            for name, record in content.pop("lenses").items()
        }
        with np.load(folder / "result.npz", allow_pickle=False) as arrays:
            return _checked(Reconstruction(**arrays, cameras=cameras, **content))
    except Exception as error:  # numpy, zipfile and json raise many types for broken files
        found = f"no {error}" if isinstance(error, KeyError) else str(error)
        raise DataError(
            folder,
            "a result of structure from motion (result.json, result.npz)",
            f"{found}; delete the folder and run again",
        ) from None


def _checked(found: Reconstruction) -> Reconstruction:
    """The argument itself; ValueError if an array or a number is invalid."""
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
    if count == 0 or np.abs(found.points).max() > MAX_DISTANCE or found.colors.dtype != np.uint8:
        raise ValueError(f"no points, points beyond {MAX_DISTANCE:g}, or colours that are not bytes")
    seen = found.observations
    if seen is not None and (seen.dtype.kind != "f" or seen.shape != (len(seen), 4) or not np.isfinite(seen).all()):
        raise ValueError(f"observations {seen.dtype} {seen.shape}, or not finite")
    numbers = (found.seconds, found.photographs, *(camera.radial for camera in found.cameras.values()))
    if found.poses not in ("known", "refined", "estimated") or not all(
        isinstance(number, (int, float)) and math.isfinite(number) for number in numbers
    ):
        raise ValueError(f"poses {found.poses!r}, or seconds, photographs or distortion that are no numbers")
    return found


def _camera_json(calibrated: CalibratedCamera) -> dict:
    camera = asdict(calibrated.camera)
    return {"camera": {**camera, "world_to_cam": camera["world_to_cam"].tolist()}, "radial": calibrated.radial}
