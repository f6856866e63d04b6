"""Structure from motion of a source, through its cache, and what follows from its points: unit of length, colours."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from datasets.canonical import Canonical, canonical_space
from datasets.source import Calibration, Photograph, Source
from pipeline.config.schema import Config, InitConfig
from pipeline.data.sfm.reconstruction import Reconstruction
from pipeline.data.sfm.run import Matching
from rasterizer.camera import Camera

# Without depth bounds the 5 % quantile of the points' depths replaces the near bound. One normalised unit is 0.75 of
# it, as in LLFF (datasets/plenoptic/poses.py).
UNIT_OF_NEAR, NEAR_QUANTILE = 0.75, 0.05


def structure_from_motion(
    cfg: Config, source: Source, log: Callable[[str], None]
) -> tuple[Reconstruction, Path, Calibration]:
    """(points and cameras in the units of the photographs' cameras, folder in the cache, what the scene needs of it).

    ValueError of one line if the photographs do not suffice.
    """
    from pipeline.data.sfm.cache import reconstruct_cached  # not needed by scenes with random points

    photographs, cache = source.photographs(), Path(cfg.scene.cache)
    log(f"sfm: {len(photographs)} images of {source.path}")
    corrected = source.several_videos and bool(cfg.scene.color_correction)
    init = cfg.init if source.one_lens else replace(cfg.init, shared_intrinsics=False)
    if source.poses == "of every frame":
        cloud, folder = reconstruct_cached(photographs, init, 1.0, source.path, cache, corrected, clip_log=log)
    else:
        cloud, folder = canonical_reconstruction(init, photographs, source.unit, source.path, cache, corrected)
    found = cloud.summary()
    registered = f"{found['registered']} of {len(photographs)} frames registered, " if source.poses != "given" else ""
    log(
        f"sfm: {registered}{found['points']} points, mean error {found['mean_error_px']:.2f} px, mean track length "
        f"{found['mean_track_length']:.1f}; cached in {folder}"
    )
    colors = {}
    if corrected:
        from pipeline.data.colors.choose import color_corrections, recolored  # not needed by scenes without it

        colors = color_corrections(photographs, cloud, source.held_out, cfg.scene.color_correction is True, log)
        cloud = recolored(photographs, cloud, source.held_out, colors)
    cameras = {name: calibrated.camera for name, calibrated in cloud.cameras.items()}
    trained = [cameras[p.name] for p in photographs if not p.held_out and p.name in cameras]
    calibration = Calibration(
        cameras if cloud.poses != "known" else {},  # which stay to the bit
        {name: calibrated.radial for name, calibrated in cloud.cameras.items()},
        UNIT_OF_NEAR * near_depth(cloud.points, trained),
        colors,
    )
    return cloud, folder, calibration


def canonical_reconstruction(
    init: InitConfig,
    photographs: list[Photograph],
    unit: float,
    source: Path,
    cache: Path,
    observations: bool = False,
    matching: Matching | None = None,
) -> tuple[Reconstruction, Path]:
    """By COLMAP in canonical coordinates, because the tolerances of its solvers are absolute.

    unit: world units per normalised unit. source: the photographs' folder, for messages.
    """
    from pipeline.data.sfm.cache import reconstruct_cached

    known = [photograph.camera for photograph in photographs if photograph.camera is not None]
    transform = canonical_space(known, unit) if known else Canonical()
    if not transform.is_identity:
        photographs = [  # all of them have a camera, or none has
            replace(photograph, camera=transform.camera(camera))
            for photograph, camera in zip(photographs, known, strict=True)
        ]
    cloud, folder = reconstruct_cached(
        photographs, init, unit * transform.scale, source, cache, observations, matching=matching
    )
    return transformed(cloud, transform.inverse), folder


def near_depth(points: np.ndarray, cameras: list[Camera]) -> float:
    """The NEAR_QUANTILE of the depths of points (N, 3) in front of all cameras, world units."""
    depths = np.concatenate([points @ c.world_to_cam[2, :3] + c.world_to_cam[2, 3] for c in cameras])
    return float(np.quantile(depths[depths > 0], NEAR_QUANTILE))


def transformed(cloud: Reconstruction, transform: Canonical) -> Reconstruction:
    """The reconstruction with points and cameras transformed."""
    if transform.is_identity:
        return cloud
    cameras = {name: replace(found, camera=transform.camera(found.camera)) for name, found in cloud.cameras.items()}
    return replace(cloud, points=transform.points(cloud.points), cameras=cameras)
