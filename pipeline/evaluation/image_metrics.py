"""Metrics of images, depth, optical flow and films as functions of arrays (docs/method.md 4). metrics.py lists them.

Images are (H, W, 3) float32 in [0, 1], masks (H, W) bool. A number is None where what it compares with is unknown.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from skimage.metrics import structural_similarity

from datasets.scene import View

SSIM_SMALLEST_SIDE = 11  # its window
# MS-SSIM halves the image four times; its 11-pixel window must fit into the smallest: 10 · 2⁴ < side.
MS_SSIM_SMALLEST_SIDE = 161
# Lower bound of the MSE, 100 dB: equal images would have infinite PSNR, and so would any mean with one of them.
SMALLEST_MSE = 1e-10
SPACING_TOLERANCE = 0.1  # frames, between consecutive ones; covers the rounding of times


@dataclass(frozen=True)
class Geometry:
    """Depth and flow of a render: sums over the Gaussians at a pixel, divided by its alpha; 0 without any."""

    depth: np.ndarray  # (H, W) float32 z, units of the scene
    flow: np.ndarray | None  # (2, H, W) float32 pixels right and down to time + flow_dt; None: not rendered


def psnr(image: np.ndarray, truth: np.ndarray) -> float:
    """Peak signal-to-noise ratio in dB, data range 1: -10 log10(MSE), at most 100."""
    error = float(np.mean(np.square(image.astype(np.float64) - truth)))
    return -10.0 * math.log10(max(error, SMALLEST_MSE))


def channels_psnr(image: np.ndarray, truth: np.ndarray) -> float:
    """The mean of the PSNRs of the three channels, as the authors' released program has it. Never below `psnr`."""
    return float(np.mean([psnr(image[..., c], truth[..., c]) for c in range(3)]))


def masked_psnr(image: np.ndarray, truth: np.ndarray, mask: np.ndarray | None) -> float | None:
    """`psnr` over the pixels of `mask` alone; None without any."""
    return psnr(image[mask], truth[mask]) if mask is not None and mask.any() else None


def ssim(image: np.ndarray, truth: np.ndarray, data_range: float = 1.0) -> float:
    """Structural similarity (Wang et al. 2004): 11×11 Gaussian window, σ = 1.5, mean over channels and over the pixels
    whose window is inside the image. ValueError for images smaller than the window."""
    return float(
        structural_similarity(
            image,
            truth,
            channel_axis=-1,
            gaussian_weights=True,
            sigma=1.5,
            use_sample_covariance=False,
            data_range=data_range,
        )
    )


def ms_ssim(image: np.ndarray, truth: np.ndarray) -> float | None:
    """Multi-scale SSIM, five scales, the same window. None below MS_SSIM_SMALLEST_SIDE."""
    import torch  # late: the report reads the list of metrics and measures none
    from pytorch_msssim import ms_ssim as of_batches

    if min(image.shape[:2]) < MS_SSIM_SMALLEST_SIDE:
        return None
    batches = [torch.from_numpy(np.ascontiguousarray(x.transpose(2, 0, 1)))[None] for x in (image, truth)]
    return float(of_batches(*batches, data_range=1.0))


def flow_errors(flow: np.ndarray, truth: np.ndarray, mask: np.ndarray) -> dict[str, float | None]:
    """{flow_error, flow_error_px, flow_true_px} of flows (2, H, W) over `mask`; {} without pixels."""
    if not mask.any():
        return {}
    error = float(np.linalg.norm(flow[:, mask] - truth[:, mask].astype(np.float64), axis=0).mean())
    length = float(np.linalg.norm(truth[:, mask].astype(np.float64), axis=0).mean())
    return {"flow_error": error / length if length > 0 else None, "flow_error_px": error, "flow_true_px": length}


def depth_errors(depth: np.ndarray, truth: np.ndarray) -> dict[str, float]:
    """{depth_error_median, depth_error_mean} of depths (H, W), relative, over the pixels with a true depth > 0."""
    mask = (truth > 0) & np.isfinite(truth)
    if not mask.any():
        return {}
    relative = np.abs(depth[mask] - truth[mask].astype(np.float64)) / truth[mask]
    return {"depth_error_median": float(np.median(relative)), "depth_error_mean": float(relative.mean())}


def lidar_errors(depth: np.ndarray, lidar: np.ndarray, metre: float) -> dict[str, float]:
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


class FlickerMeter:
    """Flicker: the mean absolute change of the error between consecutive frames of a video.

    With the residual r_t = render_t - truth_t, images (H, W, 3) in [0, 1], flicker is the mean of |r_{t+1} - r_t| over
    pixels, channels and pairs of consecutive frames. Motion that the render reproduces cancels. A constant error does
    not count, however large; PSNR measures that, but is independent of the order of frames. Only the previous residual
    is kept.
    """

    def __init__(self, frame_rate: float | None) -> None:
        """frame_rate: frames per unit of the scene's time; None for photographs, which have no flicker."""
        self._frame_rate = frame_rate
        self._before: tuple[View, np.ndarray] | None = None  # the previous view and its residual

    def next(self, view: View, image: np.ndarray, truth: np.ndarray) -> float | None:
        """Mean |r_t - r_{t-1}| of this frame; None unless the previous call was for the previous frame."""
        if self._frame_rate is None:
            return None
        now, before = np.subtract(image, truth, dtype=np.float32), self._before
        self._before = (view, now)
        if before is None or before[0].filmed_by != view.filmed_by:
            return None
        if abs((view.time - before[0].time) * self._frame_rate - 1.0) >= SPACING_TOLERANCE:
            return None
        change = np.subtract(now, before[1], out=before[1])  # reuses its memory
        return float(np.mean(np.abs(change, out=change), dtype=np.float64))
