"""What the sources share: structure from motion through its cache, and what follows from its points."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import replace
from pathlib import Path

import numpy as np

from datasets.cameras.color import ColorCorrection
from datasets.canonical import Canonical, canonical_space
from pipeline.config.schema import Config
from pipeline.data.sfm.photograph import Photograph, Reconstruction
from rasterizer.camera import Camera

# Without depth bounds the 5 % quantile of the points' depths replaces the near bound. One normalised unit is 0.75 of
# it, as in LLFF (datasets/plenoptic/poses.py).
UNIT_OF_NEAR, NEAR_QUANTILE = 0.75, 0.05


def reconstruct(
    cfg: Config, photographs: list[Photograph], unit: float, source: Path, log: Callable[[str], None]
) -> tuple[Reconstruction, Path]:
    """Structure from motion; the result is in the units of the photographs' cameras.

    COLMAP works in canonical coordinates, because the tolerances of its solvers are absolute.
    """
    from pipeline.data.sfm.cache import reconstruct_cached  # not needed by scenes with random points

    log(f"sfm: {len(photographs)} images of {source}")
    known = [photograph.camera for photograph in photographs if photograph.camera is not None]
    transform = canonical_space(known, unit) if known else Canonical()
    if not transform.is_identity:
        photographs = [  # all of them have a camera, or none has
            replace(photograph, camera=transform.camera(camera))
            for photograph, camera in zip(photographs, known, strict=True)
        ]
    cloud, folder = reconstruct_cached(
        photographs,
        cfg.init,
        unit * transform.scale,
        source,
        Path(cfg.scene.cache),
        observations=bool(cfg.scene.color_correction),
    )
    summary = cloud.summary()
    log(
        f"sfm: {summary['points']} points, mean error {summary['mean_error_px']:.2f} px, mean track length "
        f"{summary['mean_track_length']:.1f}; cached in {folder}"
    )
    return transformed(cloud, transform.inverse), folder


def corrected_colors(
    cfg: Config,
    photographs: list[Photograph],
    cloud: Reconstruction,
    held_out: Collection[str],
    log: Callable[[str], None],
) -> tuple[Reconstruction, dict[str, ColorCorrection]]:
    """The corrections of the cameras' colours by scene.color_correction, and the points in corrected colours."""
    from pipeline.data.colors import color_corrections, recolored  # not needed by scenes without it

    found = color_corrections(photographs, cloud, held_out, cfg.scene.color_correction is True, log)
    return recolored(photographs, cloud, held_out, found), found


def normalised_unit(points: np.ndarray, cameras: list[Camera]) -> float:
    """World units per normalised unit, of points (N, 3) in front of all cameras."""
    return UNIT_OF_NEAR * near_depth(points, cameras)


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
