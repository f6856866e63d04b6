"""Metrics of moving pixels, of the foreground, of optical flow and of depth (docs/method.md 4).

A number is None where what it compares with is unknown.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from datasets.ground_truth import GroundTruth
from pipeline.evaluation.metrics import psnr

MOTION_METRICS = (
    "psnr_moving",  # dB over moving pixels
    "psnr_still",  # dB over all others
    "psnr_foreground",  # dB over pixels with alpha > 0
    "psnr_masked",  # dB over the pixels that the data set's masks count: mPSNR of Gao et al. 2022
    "flow_error",  # flow_error_px / flow_true_px
    "flow_error_px",  # mean end-point error over moving pixels with a known flow
    "flow_true_px",  # mean length of the true flow there
    "depth_error_median",  # of |depth - truth| / truth over pixels with a known depth
    "depth_error_mean",
    "lidar_error_median",  # of |depth - LiDAR| / LiDAR over the held-out LiDAR points that the view sees
    "lidar_error_mean",
    "lidar_rmse",  # metres, likewise
)

Row = Mapping[str, float | None]


@dataclass(frozen=True)
class Geometry:
    """Depth and flow of a render: sums over the Gaussians at a pixel, divided by its alpha; 0 without any."""

    depth: np.ndarray  # (H, W) float32 z, units of the scene
    flow: np.ndarray | None  # (2, H, W) float32 pixels right and down to time + flow_dt; None: not rendered


def measure_motion(
    image: np.ndarray,
    truth: np.ndarray,
    moving: np.ndarray | None,
    foreground: np.ndarray | None,
    geometry: Geometry | None,
    known: GroundTruth | None,
    counted: np.ndarray | None = None,
    lidar: np.ndarray | None = None,
    metre: float = 1.0,
) -> dict[str, float | None]:
    """MOTION_METRICS and `moving_share` of one view.

    image, truth: (H, W, 3) in [0, 1]. moving, foreground, counted: (H, W) bool. geometry: of the render; None where
    `known` has neither depth nor flow and there is no `lidar`, (H, W) depths of held-out points, 0 where there are
    none. metre: units of the scene.
    """
    found: dict[str, float | None] = {
        "psnr_moving": None if moving is None else masked_psnr(image, truth, moving),
        "psnr_still": None if moving is None else masked_psnr(image, truth, ~moving),
        "psnr_foreground": None if foreground is None else masked_psnr(image, truth, foreground),
        "psnr_masked": None if counted is None else masked_psnr(image, truth, counted),
        **dict.fromkeys(MOTION_METRICS[4:]),
        "moving_share": None if moving is None else float(moving.mean()),
    }
    if geometry is not None and lidar is not None:
        found |= lidar_errors(geometry.depth, lidar, metre)
    if geometry is None or known is None:
        return found
    if geometry.flow is not None and known.flow is not None and known.flow_valid is not None and moving is not None:
        found |= flow_errors(geometry.flow, known.flow, known.flow_valid & moving)
    if known.depth is not None:
        found |= depth_errors(geometry.depth, known.depth)
    return found


def masked_psnr(image: np.ndarray, truth: np.ndarray, mask: np.ndarray) -> float | None:
    """metrics.psnr over the pixels of `mask` (H, W) alone; None without any."""
    return psnr(image[mask], truth[mask]) if mask.any() else None


def flow_errors(flow: np.ndarray, truth: np.ndarray, mask: np.ndarray) -> dict[str, float | None]:
    """{flow_error, flow_error_px, flow_true_px} of flows (2, H, W) over `mask` (H, W); None without pixels."""
    if not mask.any():
        return {}
    error = float(np.linalg.norm(flow[:, mask] - truth[:, mask].astype(np.float64), axis=0).mean())
    length = float(np.linalg.norm(truth[:, mask].astype(np.float64), axis=0).mean())
    return {"flow_error": _share(error, length), "flow_error_px": error, "flow_true_px": length}


def depth_errors(depth: np.ndarray, truth: np.ndarray) -> dict[str, float | None]:
    """{depth_error_median, depth_error_mean} of depths (H, W), relative, over the pixels with a true depth > 0."""
    mask = (truth > 0) & np.isfinite(truth)
    if not mask.any():
        return {}
    relative = np.abs(depth[mask] - truth[mask].astype(np.float64)) / truth[mask]
    return {"depth_error_median": float(np.median(relative)), "depth_error_mean": float(relative.mean())}


def lidar_errors(depth: np.ndarray, lidar: np.ndarray, metre: float) -> dict[str, float | None]:
    """{lidar_error_median, lidar_error_mean, lidar_rmse} of a rendered depth (H, W) at held-out LiDAR points (H, W)."""
    relative = depth_errors(depth, lidar)
    if not relative:
        return {}
    mask = lidar > 0
    difference = (depth[mask] - lidar[mask].astype(np.float64)) / metre
    return {
        "lidar_error_median": relative["depth_error_median"],
        "lidar_error_mean": relative["depth_error_mean"],
        "lidar_rmse": float(np.sqrt(np.mean(difference**2))),
    }


def motion_means(rows: Sequence[Row]) -> dict[str, float | None]:
    """MOTION_METRICS of a model: means over the images that have the number. flow_error is the ratio of two means."""
    found = {name: mean_of_known([row[name] for row in rows]) for name in MOTION_METRICS}
    error, length = found["flow_error_px"], found["flow_true_px"]
    found["flow_error"] = None if error is None or length is None else _share(error, length)
    return found


def mean_of_known(values: Sequence[float | None]) -> float | None:
    """Mean over the images that have the number, such as those with moving pixels; None if there are none."""
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None


def _share(error: float, length: float) -> float | None:
    return error / length if length > 0 else None
