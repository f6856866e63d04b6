"""Image metrics by name (docs/method.md 4): functions of two images, (H, W, 3) float32 in [0, 1], to a number or None.

To add one, write the function and enter it in METRICS; evaluate.py, metrics.json and per_image.csv follow. LPIPS, which
needs downloaded weights, is in lpips.py.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np
import torch
from pytorch_msssim import ms_ssim as _ms_ssim
from skimage.metrics import structural_similarity

SSIM_SMALLEST_SIDE = 11  # its window
# MS-SSIM halves the image four times; its 11-pixel window must fit into the smallest: 10 · 2⁴ < side.
MS_SSIM_SMALLEST_SIDE = 161
MS_SSIM_NOTE = f"MS-SSIM needs images of at least {MS_SSIM_SMALLEST_SIDE} px a side"

# Lower bound of the MSE, 100 dB: equal images would have infinite PSNR, and so would any mean with one of them.
SMALLEST_MSE = 1e-10

Metric = Callable[[np.ndarray, np.ndarray], "float | None"]


def psnr(image: np.ndarray, truth: np.ndarray) -> float:
    """Peak signal-to-noise ratio in dB, data range 1: -10 log10(MSE), at most 100."""
    error = float(np.mean(np.square(image.astype(np.float64) - truth)))
    return -10.0 * math.log10(max(error, SMALLEST_MSE))


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
    if min(image.shape[:2]) < MS_SSIM_SMALLEST_SIDE:
        return None
    return float(_ms_ssim(_batch(image), _batch(truth), data_range=1.0))


def dssim1(image: np.ndarray, truth: np.ndarray) -> float:
    """(1 - SSIM) / 2 with data range 1."""
    return (1.0 - ssim(image, truth)) / 2.0


def dssim2(image: np.ndarray, truth: np.ndarray) -> float:
    """(1 - SSIM) / 2 with data range 2, for images in [0, 1]. SSIM's constants are then four times too large and
    the result is smaller. Part of the literature reports it."""
    return (1.0 - ssim(image, truth, data_range=2.0)) / 2.0


METRICS: dict[str, Metric] = {"psnr": psnr, "ssim": ssim, "ms_ssim": ms_ssim, "dssim1": dssim1, "dssim2": dssim2}


def measure(image: np.ndarray, truth: np.ndarray) -> dict[str, float | None]:
    """Every metric of METRICS. Raises ValueError for images of different sizes and for a render that is not finite."""
    if image.shape != truth.shape or image.ndim != 3 or image.shape[2] != 3:
        raise ValueError(f"metrics: expected two images (H, W, 3) of one size, found {image.shape} and {truth.shape}")
    if not np.isfinite(image).all():
        raise ValueError("metrics: expected finite pixels, found NaN or Inf in the render")
    similarity = ssim(image, truth)  # computed once for two metrics: half of the total time
    known = {"ssim": similarity, "dssim1": (1.0 - similarity) / 2.0}
    return {name: known[name] if name in known else metric(image, truth) for name, metric in METRICS.items()}


def mean(rows: Sequence[Mapping[str, float | None]], name: str) -> float | None:
    """Mean of a column over images; None if any value is missing, so that no mean is over a part of the images."""
    values = [value for row in rows if (value := row[name]) is not None]
    return float(np.mean(values)) if values and len(values) == len(rows) else None


def _batch(image: np.ndarray) -> torch.Tensor:
    """(H, W, 3) -> (1, 3, H, W)."""
    return torch.from_numpy(np.ascontiguousarray(image.transpose(2, 0, 1)))[None]
