"""Plots points and cameras of a reconstruction from above and from the front (sfm.png)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pipeline.data.sfm.reconstruction import Reconstruction
from rasterizer.camera import Camera

AXIS_PERCENTILE = 98.0  # of the points; outliers lie outside the axes
MAX_DRAWN = 20_000


def plot_reconstruction(result: Reconstruction, path: Path) -> None:
    """Writes `path` (PNG). Axes are those of the mean camera: x right, y up, z away from the cameras, world units."""
    from matplotlib.figure import Figure  # without pyplot: nothing global, no display

    world_to_view, centre = mean_view([found.camera for found in result.cameras.values()])
    positions = np.stack([found.camera.position for found in result.cameras.values()])
    points, cameras = ((x - centre) @ world_to_view.T for x in (result.points, positions))
    every = max(1, len(points) // MAX_DRAWN)
    points, colors = points[::every], result.colors[::every] / 255
    reach = np.maximum(np.percentile(np.abs(points), AXIS_PERCENTILE, axis=0), np.abs(cameras).max(axis=0))

    figure = Figure(figsize=(11, 5), layout="constrained")
    for axes, up, title in zip(figure.subplots(1, 2), (2, 1), ("from above", "from the cameras")):
        sign = -1 if up == 1 else 1  # image y points down
        axes.scatter(points[:, 0], sign * points[:, up], s=2, c=colors, linewidths=0)
        axes.scatter(cameras[:, 0], sign * cameras[:, up], s=30, marker="^", c="#c0392b", label="cameras")
        axes.set(title=title, xlabel="right", ylabel="away" if up == 2 else "up", aspect="equal")
        axes.set_xlim(-1.1 * reach[0], 1.1 * reach[0])
        low = min(0.0, float(np.min(sign * cameras[:, up]))) if up == 2 else -1.1 * reach[1]
        axes.set_ylim(low - 0.05 * reach[up], 1.1 * reach[up])
        axes.set_facecolor("#d9dde3")
    axes.legend(loc="lower right")
    error, track = result.errors.mean(), result.track_lengths.mean()
    figure.suptitle(
        f"{len(result.points):,} points, mean error {error:.2f} px, mean track length {track:.1f}; "
        f"{len(cameras)} cameras, poses {result.poses}"
    )
    figure.savefig(path, format="png", dpi=110)


def mean_view(cameras: list[Camera]) -> tuple[np.ndarray, np.ndarray]:
    """(world_to_view (3, 3), centre (3,)): the mean rotation and the mean position of all cameras."""
    rotations = np.mean([camera.world_to_cam[:3, :3] for camera in cameras], axis=0)
    u, _, vt = np.linalg.svd(rotations)  # the rotation nearest to the mean
    return u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt, np.mean([camera.position for camera in cameras], axis=0)
