"""The list of metrics: what a run measures and writes to metrics.json, prints at its end, and shows in the report.

To add a metric, append a `Metric` to METRICS. The evaluation then measures it on every test view, and metrics.json,
per_image.csv, the table on the terminal and the columns of the report have it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from datasets.ground_truth import GroundTruth
from pipeline.evaluation.image_metrics import (
    Geometry,
    channels_psnr,
    depth_errors,
    flow_errors,
    lidar_errors,
    masked_psnr,
    ms_ssim,
    psnr,
    ssim,
)

Row = Mapping[str, float | None]


@dataclass(frozen=True)
class MeasuredView:
    """One test view: its render, and all that is known of the truth. ValueError for images that cannot be compared."""

    image: np.ndarray  # (H, W, 3) float32 in [0, 1]
    truth: np.ndarray  # (H, W, 3) in [0, 1]
    dynamic: np.ndarray | None = None  # (H, W) bool: the dynamic region
    foreground: np.ndarray | None = None  # (H, W) bool
    valid: np.ndarray | None = None  # (H, W) bool: the data set's mask of valid pixels
    geometry: Geometry | None = None  # of the render
    known: GroundTruth | None = None
    lidar: np.ndarray | None = None  # (H, W) depths of held-out LiDAR points; 0: none
    metre: float = 1.0  # units of the scene
    flicker: float | None = None  # image_metrics.FlickerMeter; None: no previous frame
    lpips: Callable[[str], float | None] = lambda net: None  # by a network, `alex` or `vgg`

    def __post_init__(self) -> None:
        image, truth = self.image, self.truth
        if image.shape != truth.shape or image.ndim != 3 or image.shape[2] != 3:
            raise ValueError(
                f"metrics: expected two images (H, W, 3) of one size, found {image.shape} and {truth.shape}"
            )
        if not np.isfinite(image).all():
            raise ValueError("metrics: expected finite pixels, found NaN or Inf in the render")

    @cached_property
    def ssim(self) -> float:
        return ssim(self.image, self.truth)

    @cached_property
    def ms_ssim(self) -> float | None:
        return ms_ssim(self.image, self.truth)

    @cached_property
    def errors(self) -> Row:
        """Of depth and flow (image_metrics.depth_errors, flow_errors over the dynamic region, lidar_errors); only those
        whose truth is known."""
        found, known = self.geometry, self.known
        errors: dict[str, float | None] = {}
        if found is None:
            return {}
        if known is not None and known.depth is not None:
            errors |= depth_errors(found.depth, known.depth)
        if known is not None and known.flow is not None and found.flow is not None and self.dynamic is not None:
            assert known.flow_valid is not None
            errors |= flow_errors(found.flow, known.flow, known.flow_valid & self.dynamic)
        if self.lidar is not None:
            errors |= lidar_errors(found.depth, self.lidar, self.metre)
        return errors


SeeView = Callable[[str, MeasuredView], None]  # takes the name of a test view and the view


@dataclass(frozen=True)
class Metric:
    """One number of metrics.json, and how it is shown.

    A mean over the test views is None unless every view has the number; with `partial` it is over the views that do.
    """

    key: str  # in metrics.json
    title: str
    unit: str = ""
    decimals: int = 2
    better: str = "higher"  # higher | lower | "": neither
    group: str = "quality"  # quality | similarity | region | flow | depth | lidar | flicker | speed | cost
    measure: Callable[[MeasuredView], float | None] | None = None  # of a test view; None: measured for the whole run
    partial: bool = False
    ratio_of: tuple[str, str] | None = None  # the mean is the ratio of the means of these two
    scale: float = 1.0  # shown is this times the number of metrics.json
    note: str = ""  # its definition, under every table with the metric

    @property
    def name(self) -> str:
        """Title and unit: `PSNR, dynamic region, dB`."""
        return f"{self.title}, {self.unit}" if self.unit else self.title

    @property
    def header(self) -> str:
        """The name and an arrow that points to better numbers."""
        return f"{self.name} {'↑' if self.better == 'higher' else '↓'}" if self.better else self.name

    def column(self, protocol: str) -> str:
        """In the report's tables: a cost has one for both protocols, final and best_on_test."""
        return self.key if self.group == "cost" else f"{protocol}.{self.key}"

    def text(self, value: float | None) -> str:
        """A number of metrics.json as it is shown."""
        return "–" if value is None else f"{self.scale * value:,.{self.decimals}f}"


_REGION = (
    "Dynamic region: pixels of moving bodies, where these are known; elsewhere pixels whose true colour changes by "
    "more than 0.1 in the views of a camera at rest. Static region: all others. Foreground: alpha > 0. Valid pixels: "
    "those of the data set's masks (mPSNR)."
)
_FLOW = "Flow error: mean end-point error in the dynamic region, as a share of the mean true flow there."
_DEPTH = "Depth error: |z − truth| / truth."
_LIDAR = "LiDAR: rendered depth against held-out LiDAR points that the view sees; AbsRel is the mean relative error."
_DSSIM = (
    "DSSIM = (1 − MS-SSIM)/2, as in the paper. DSSIM1 and DSSIM2 = (1 − SSIM)/2 with data range 1 and 2. The "
    "literature uses all three under one name."
)
_PSNR = (
    "PSNR: of the whole image. PSNR, mean of channels: of red, green and blue each, averaged, as the authors' released "
    "program reports it; it is never lower."
)
_FPS = "FPS: the whole renderer, from 4D Gaussians to the image. FPS, blending: that stage alone."


def _region(key: str, title: str, region: Callable[[MeasuredView], np.ndarray | None]) -> Metric:
    """PSNR over some pixels, (H, W) bool."""

    def measure(view: MeasuredView) -> float | None:
        return masked_psnr(view.image, view.truth, region(view))

    return Metric(key, title, "dB", group="region", measure=measure, partial=True, note=_REGION)


def _error(key: str, title: str, unit: str, decimals: int, group: str, note: str, **others: Any) -> Metric:
    """One of MeasuredView.errors."""
    shown = {"better": "lower", "measure": lambda view: view.errors.get(key), "partial": True, **others}
    return Metric(key, title, unit, decimals, group=group, note=note, **shown)


METRICS: dict[str, Metric] = {
    metric.key: metric
    for metric in (
        Metric("psnr", "PSNR", "dB", measure=lambda view: psnr(view.image, view.truth)),
        Metric(
            "psnr_channels", "PSNR, mean of channels", "dB", note=_PSNR,
            measure=lambda view: channels_psnr(view.image, view.truth),
        ),
        Metric("ssim", "SSIM", decimals=4, measure=lambda view: view.ssim),
        Metric("lpips_alex", "LPIPS-Alex", "", 3, "lower", measure=lambda view: view.lpips("alex"), partial=True),
        Metric("lpips_vgg", "LPIPS-VGG", "", 3, "lower", measure=lambda view: view.lpips("vgg"), partial=True),
        Metric("ms_ssim", "MS-SSIM", "", 4, "higher", "similarity", lambda view: view.ms_ssim),
        Metric(
            "dssim", "DSSIM", "", 4, "lower", "similarity", note=_DSSIM,
            measure=lambda view: None if view.ms_ssim is None else (1.0 - view.ms_ssim) / 2.0,
        ),
        Metric("dssim1", "DSSIM1", "", 4, "lower", "similarity", lambda view: (1.0 - view.ssim) / 2.0, note=_DSSIM),
        Metric(
            "dssim2", "DSSIM2", "", 4, "lower", "similarity", note=_DSSIM,
            measure=lambda view: (1.0 - ssim(view.image, view.truth, data_range=2.0)) / 2.0,
        ),
        _region("psnr_moving", "PSNR, dynamic region", lambda view: view.dynamic),
        _region("psnr_still", "PSNR, static region", lambda view: None if view.dynamic is None else ~view.dynamic),
        _region("psnr_foreground", "PSNR, foreground", lambda view: view.foreground),
        _region("psnr_masked", "PSNR, valid pixels", lambda view: view.valid),
        _error("flow_error", "Flow error", "", 3, "flow", _FLOW, ratio_of=("flow_error_px", "flow_true_px")),
        _error("flow_error_px", "End-point error", "px", 2, "flow", _FLOW),
        _error("flow_true_px", "True flow", "px", 2, "flow", _FLOW, better=""),
        _error("depth_error_median", "Depth error, median", "", 4, "depth", _DEPTH),
        _error("depth_error_mean", "Depth error, mean", "", 4, "depth", _DEPTH),
        _error("lidar_error_median", "LiDAR depth error, median", "", 4, "lidar", _LIDAR),
        _error("lidar_error_mean", "LiDAR AbsRel", "", 4, "lidar", _LIDAR),
        _error("lidar_rmse", "LiDAR RMSE", "m", 2, "lidar", _LIDAR),
        Metric(
            "flicker", "Flicker", "levels of 255", 2, "lower", "flicker", lambda view: view.flicker,
            partial=True, scale=255.0,
            note="Flicker: mean change of render − truth between consecutive frames of a held-out camera.",
        ),
        Metric("fps_render", "FPS", "", 1, "higher", "speed", note=_FPS),
        Metric("fps_raster", "FPS, blending", "", 1, "higher", "speed", note=_FPS),
        Metric("iterations", "Iterations", "", 0, "", "cost"),
        Metric("train_seconds", "Training", "s", 1, "lower", "cost", note="Training: without evaluation."),
        Metric("train_cpu_seconds", "Training, all threads", "CPU s", 1, "lower", "cost"),
        Metric("n_gaussians", "Gaussians", "", 0, "", "cost"),
        Metric("n_alive_mean", "Gaussians alive in a frame", "", 0, "", "cost"),
        Metric("model_mb", "Model", "MB", 1, "lower", "cost"),
        Metric("model_with_optimiser_mb", "Model with optimiser", "MB", 1, "lower", "cost"),
        Metric("peak_rss_mb", "Peak memory", "MB", 0, "lower", "cost"),
    )
}  # fmt: skip


def measure(view: MeasuredView) -> dict[str, float | None]:
    return {key: metric.measure(view) for key, metric in METRICS.items() if metric.measure}


def means(rows: Sequence[Row]) -> dict[str, float | None]:
    """The metrics of a model from those of its test views."""
    found = {key: mean(rows, key, metric.partial) for key, metric in METRICS.items() if metric.measure}
    for key, metric in METRICS.items():
        if metric.ratio_of:
            over, under = (found[part] for part in metric.ratio_of)
            found[key] = over / under if over is not None and under else None
    return found


def mean(rows: Sequence[Row], key: str, partial: bool = False) -> float | None:
    """Mean of a column; None if a value is missing, or, with `partial`, if all are."""
    known = [value for row in rows if (value := row[key]) is not None]
    return float(np.mean(known)) if known and (partial or len(known) == len(rows)) else None


def quality_table(final: Row, best: Row | None) -> list[tuple[str, str, str]]:
    """(metric, final, best on test) for the terminal: image quality, and what else there is a number for."""
    return [
        (metric.name, metric.text(final.get(key)), metric.text((best or {}).get(key)))
        for key, metric in METRICS.items()
        if metric.group != "cost" and (metric.group == "quality" or (metric.better and final.get(key) is not None))
    ]
